"""A frame simulated again from its header and its catalogue of true objects: `csstsim recreate`."""
