"""The simulation of one job: its state, the ordered layers, and the contract of a layer."""
