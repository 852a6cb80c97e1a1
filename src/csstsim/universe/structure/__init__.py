"""Structure of the embedded universe: haloes of dark matter and the density that galaxies follow."""
