"""Objects drawn in several parts: knots, tiles of images, and pieces of trails."""
