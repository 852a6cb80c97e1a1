"""`csstsim compare`: what differs between two runs, by how much, and where; what must differ is left out."""
