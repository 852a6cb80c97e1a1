"""Positions, fluxes, radii and shapes of sources."""
