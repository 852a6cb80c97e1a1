"""What all of csstsim stands on: errors, units, random streams, threads, typed models. It imports nothing above."""
