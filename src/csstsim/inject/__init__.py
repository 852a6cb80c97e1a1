"""Objects put into frames that exist: `csstsim inject`, `csstsim recover`, Simulation.inject (docs: Injection).

Frames of csstsim are drawn on by its own renderer, before the detector (`light`, `shot`). The light meets flat, shutter
and pixel response, and has its own Poisson noise. Then it goes into a calibrated image (`calibrated`), or through the
detector into a Level-0 frame (`level0`).
"""
