"""Layers of the readout compared with other codes."""
