"""Where a grating sends light of each order."""
