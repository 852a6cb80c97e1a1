"""A frame drawn again from its header and its catalogue of true objects: `csstsim recreate`."""
