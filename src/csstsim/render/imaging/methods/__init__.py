"""The drawing methods of imaging chips, one file each; csstsim.render.imaging.register lists them."""
