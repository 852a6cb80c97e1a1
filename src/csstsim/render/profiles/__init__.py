"""Profiles of light: what each renderer asks of one."""
