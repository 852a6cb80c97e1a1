"""Objects of imaging chips drawn by every method."""
