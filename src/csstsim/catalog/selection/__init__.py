"""Which objects reach a chip, which can be drawn, and in what order."""
