"""A campaign: its files, its jobs, what they cost and how far they are."""
