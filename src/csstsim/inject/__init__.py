"""Objects put into frames that exist: `csstsim inject`, `csstsim recover`, Simulation.inject (docs: Injection).

Objects in frames of csstsim are rendered by csstsim, before the detector (`light`). Flat, shutter and pixel response
act on their light, which has its own Poisson noise. It is added to a calibrated image (`calibrated`), or goes through
the detector into a Level-0 frame (`level0`). `others` renders objects into images of other telescopes.

May import: studies, delivery, stages, campaign, simulation, layers, report, render, measure, io, optics, catalog,
universe, instrument, detector, base.
"""
