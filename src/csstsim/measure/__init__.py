"""Calibration of frames, measurement of sources and spectra, and bricks: merging and validation."""
