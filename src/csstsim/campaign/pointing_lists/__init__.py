"""Other people's lists of pointings, made into survey tables: `csstsim import-pointings`."""
