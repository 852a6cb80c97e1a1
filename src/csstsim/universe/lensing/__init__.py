"""Weak lensing of the embedded universe, and the cosmology behind it."""
