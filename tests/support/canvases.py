"""Blank canvases for tests of the renderers."""

import numpy as np

from csstsim.render.canvas import Canvas


def blank(window, dtype=np.float32, **light):
    """Return a Canvas without light; light: its response and maximum."""
    return Canvas(np.zeros(window.shape, dtype), window, **light)


def counting(window, **light):
    """Return a Canvas with a plane of counted electrons alone."""
    canvas = Canvas(None, window, **light)
    canvas.count()
    return canvas
