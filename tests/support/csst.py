"""Facts about the shipped camera for tests that do not read it: bands, pixel, how its filters are drawn."""

from types import SimpleNamespace

from csstsim.catalog.selection.bricks import BRICK_MARGIN_PX
from csstsim.report.style import band_styles

BANDS = ("nuv", "u", "g", "r", "i", "z", "y")  # as Camera.bands
PIXEL = 0.074  # arcsec
KINDS = dict.fromkeys(("NUV", *BANDS[1:]), "imaging") | dict.fromkeys(("GU", "GV", "GI"), "slitless")
LOOKS = band_styles({name: SimpleNamespace(kind=kind) for name, kind in KINDS.items()})
MARGIN = BRICK_MARGIN_PX * PIXEL / 3600.0  # deg
