"""Light that falls far from its image: halo, ghosts."""
