"""Images of other telescopes: what they say of themselves, their PSFs, and objects drawn into them by GalSim."""
