"""Layers of the readout beside other codes."""
