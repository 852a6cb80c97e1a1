"""The PSF of a chip: computation, storage, interpolation."""
