"""Spectra drawn by every method."""
