"""The objects of the sky: catalogues, light, astrometry, and the selection of what reaches a chip."""
