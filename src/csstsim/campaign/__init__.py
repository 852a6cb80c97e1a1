"""A campaign: its files, jobs, costs and progress."""
