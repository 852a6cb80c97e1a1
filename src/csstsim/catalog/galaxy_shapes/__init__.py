"""What a galaxy looks like: components, knots, images, parts; and columns of other conventions, refused."""
