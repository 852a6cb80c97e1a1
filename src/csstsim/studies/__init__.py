"""Studies with whole campaigns, for the command line: benchmark, budgets, comparison, recreation, releases."""
