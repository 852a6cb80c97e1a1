"""Frames calibrated, sources found and measured, spectra extracted: what a user of the data would do."""
