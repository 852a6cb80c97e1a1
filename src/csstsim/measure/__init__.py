"""Calibration of frames, detection and measurement of sources, extraction of spectra."""
