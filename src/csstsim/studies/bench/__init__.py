"""`csstsim bench`: the cost and the error of each method to draw an object."""
