"""Profiles of light: in one place what selection, rendering and measurement ask of one."""
