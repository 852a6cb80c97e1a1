"""A running campaign: logs of jobs, finished products, time and memory used."""
