"""`csstsim compare`: differences between two runs, how large and where. Dates and run times are left out."""
