"""A campaign while it runs: logs of jobs, what is finished, what it took."""
