"""csstsim: an open simulator of the CSST Survey Camera."""

__version__ = "0.1.0"
