"""Where gratings send the light of each order."""
