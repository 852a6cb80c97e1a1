"""The drawing methods of spectroscopic chips, one file each; csstsim.render.slitless.register lists them."""
