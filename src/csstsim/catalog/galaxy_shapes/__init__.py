"""Shapes of galaxies: components, knots, images, parts; and columns of other conventions, which are refused."""
