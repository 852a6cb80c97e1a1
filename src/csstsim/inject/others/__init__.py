"""Images of other telescopes: what their headers state, their PSFs, and objects rendered into them by GalSim."""
