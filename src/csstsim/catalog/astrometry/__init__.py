"""Astrometry: from catalogue places to the directions that the spacecraft sees, and back."""
