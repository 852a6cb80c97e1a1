"""Objects that change with time: light curves, motion on the sky."""
