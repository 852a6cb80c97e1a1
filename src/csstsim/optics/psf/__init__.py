"""The PSF of a chip: computed, kept, interpolated."""
