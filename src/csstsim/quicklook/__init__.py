"""Pictures of a file: reading -> reducing -> stretching -> drawing; what `csstsim show` does."""
