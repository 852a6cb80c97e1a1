"""`csstsim compare`: differences between two runs, their size and position. Dates and run times are not compared."""
