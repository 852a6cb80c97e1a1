"""Finding sources in a calibrated frame."""
