"""Positions of light by the shipped .conf files against grismagic, an independent reader of aXe's form.

pip install --no-deps grismagic (its dependency jax is only for rendering). The reader is `GrismTrace.from_axe`.
"""

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.axe import BEAMS

peer = pytest.importorskip("grismagic.traces", reason="needs grismagic: pip install --no-deps grismagic")


def test_positions_and_wavelengths(camera):
    """Every order of all 24 gratings, at 5 x 5 direct images and 9 wavelengths: 0.05 px is asked, 1e-5 px kept."""
    seen, worst_px, worst_a = 0, 0.0, 0.0
    for two in camera.gratings.values():
        for grating, (x0, x1, y0, y1) in two.pieces:
            trace = peer.GrismTrace.from_axe(str(SHIPPED / "instrument" / "gratings" / f"{grating.name}.conf"))
            assert sorted(trace.orders) == sorted(BEAMS)
            for beam, order in ((beam, grating.orders[number]) for beam, number in BEAMS.items()):
                waves = np.linspace(*order.range, 9)
                for x in np.linspace(x0, x1, 5):
                    for y in np.linspace(y0, y1, 5):
                        p, q, r, s = order.lines(x, y)
                        ours = x + p + q * waves, y + r + s * waves
                        _, y_there, wave_there = trace.get_trace(x, y, beam, offset=p + q * waves)
                        worst_a = max(worst_a, np.abs(wave_there - waves).max() * abs(q))
                        theirs = trace.get_trace_at_wavelength(x, y, beam, waves)
                        error = np.hypot(theirs[0] - ours[0], theirs[1] - ours[1])
                        inside = (p + q * waves >= order.extent[0]) & (p + q * waves <= order.extent[1])
                        worst_px = max(worst_px, error[inside].max(), np.abs(y_there - ours[1]).max())
                        assert inside.all()
                        seen += len(waves)
    assert seen == 24 * 5 * 25 * 9
    print(f"worst: {worst_px:.1e} px, {worst_a:.1e} px by wavelength")
    assert worst_px < 1e-5 and worst_a < 1e-5
