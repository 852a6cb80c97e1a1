"""Astrometry: from catalogue positions to apparent directions at the spacecraft, and back."""
