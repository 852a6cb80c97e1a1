"""Which objects reach a chip, which can be rendered, and in what order."""
