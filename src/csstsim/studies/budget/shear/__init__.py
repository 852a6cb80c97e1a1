"""The budget of shear: bias by effect, from campaigns in arms of opposite shear that share all their noise."""
