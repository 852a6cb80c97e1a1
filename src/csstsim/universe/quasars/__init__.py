"""Quasars of the embedded universe."""
