"""`csstsim bench`: what each way to draw an object costs, and how wrong it is."""
