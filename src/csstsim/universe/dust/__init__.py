"""The Milky Way's dust: reddening maps and the extinction law."""
