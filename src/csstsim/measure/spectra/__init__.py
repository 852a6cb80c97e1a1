"""Slitless spectra extracted, and their figures."""
