"""The benchmark of objects on imaging chips."""
