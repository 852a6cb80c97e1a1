"""What is in the sky, as the simulator sees it: catalogues, their objects, light, places and selection."""
