"""Random numbers of pixels."""
