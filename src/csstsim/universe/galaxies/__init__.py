"""Galaxies of the embedded universe."""
