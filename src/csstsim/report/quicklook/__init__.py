"""Pictures of a file for `csstsim show`: read, reduce, stretch, draw."""
