"""Kernels of the detector: arrays in, arrays out. They know nothing of the rest of csstsim."""
