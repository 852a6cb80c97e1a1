"""Light that lands far from its image: halo, ghosts."""
