"""`csstsim bench`: the cost and the error of each method that renders objects."""
