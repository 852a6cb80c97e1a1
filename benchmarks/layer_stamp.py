"""A stamp of a chip that shows every layer: objects, the chip's own defects, two channels, and cosmic rays.

It lies across the edge of two readout channels, far from their amplifiers, at the first position (by campaign seed,
then by edge) with a hot and a dead pixel and a bad column; its exposure is the first with enough cosmic rays. Layers
run as in a campaign, with the parameters of the shipped lists: science_paper.yaml, which has the irradiated device, and
led_flat.yaml for the lamps.
"""

from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.detector import mask
from csstsim.detector.channels import ReadoutFrame
from csstsim.instrument.chip import Window
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.sim_steps import STAGES, SimSteps
from csstsim.simulation.state import State
from csstsim.studies.bench.setting import POINTING

NX, NY = 94, 96  # px; 192 x 180 with the prescan and overscan between the channels and above
FIRST_ROW = 3000  # from here to the seam of the halves
INSIDE, EDGE_INSIDE = 10, 30  # px, from the stamp's border to the defects, and to the edge of the channels
FIRST = 10100000001  # obsid to try
TRACKS = 3  # of cosmic rays in the stamp
OBJECTS = [  # x, y in the stamp [px], electrons, half-light radius [arcsec], e1, e2
    (32, 40, 5e6, 0, 0, 0), (66, 74, 1.2e5, 0, 0, 0), (80, 20, 1.5e4, 0, 0, 0), (23, 80, 6e3, 0, 0, 0),
    (62, 10, 3e3, 0, 0, 0), (54, 50, 3e4, 0.5, 0.4, 0.3), (83, 46, 8e3, 0.3, -0.2, 0.3), (44, 84, 1e4, 0.35, 0.1, -0.4),
    (22, 13, 8e3, 0.4, -0.3, -0.1),
]  # fmt: skip
_LISTS = [SimSteps(SHIPPED / "observations" / f"{name}.yaml") for name in ("led_flat", "science_paper")]
STEPS = {step.name: step for steps in _LISTS for step in steps}  # the last list with a layer counts


@dataclass(frozen=True, eq=False)
class Stamp:
    """The stamp's window, seed and exposure."""

    setting: object  # csstsim.studies.bench.setting.Setting
    window: Window
    seed: int
    obsid: str

    def run(self, names):
        """Return the State after these layers (keywords in lower case)."""
        setting, steps = self.setting, SimSteps(_LISTS[0].file)
        steps.steps = [STEPS[name] for name in names]
        exposure = Exposure(
            POINTING, setting.chip, self.window, setting.wcs, setting.camera,
            losses=steps.losses, mask=True, fidelity="noise_free",
        )  # fmt: skip
        state = State.blank(exposure, self.objects())
        state.psf, state.tables = setting.psf, setting.table
        for stage in STAGES:
            state = steps.run(state, stage, Streams(self.seed, self.obsid, setting.chip.id, ""))
        return state

    def objects(self):
        """Return the ObjectTable as catalog.selection.select leaves it."""
        x, y, electrons, size, e1, e2 = np.array(OBJECTS).T
        x, y = x + self.window.x0, y + self.window.y0
        ra, dec = self.setting.wcs.pixel_to_world(x, y)
        columns = {
            "id": np.arange(len(x)), "obj_type": np.where(size > 0, GALAXY, STAR), "ra": ra, "dec": dec, "ra_orig": ra,
            "dec_orig": dec, "x": x, "y": y, "size_disk": size, "size_bulge": size / 2, "bulge_frac": 0.3 * (size > 0),
            "e1": e1, "e2": e2, "reach": np.full(len(x), 64, np.int32), "wing": np.where(electrons > 1e6, 400.0, 0.0),
            "lost": np.full(len(x), 1e-4),
        } | {f"flux{i}": electrons / 4 / POINTING.exptime for i in range(4)}  # fmt: skip
        return ObjectTable.complete(columns, ())

    def pair(self, base, name):
        """Return (before, after, framed, header) of a layer: float64 images after the layers `base`, and after it, too.

        `framed` is `before` in the frame of `after`, for the difference. Readout frames are cut to the range of the
        stamp's columns. Header values of the sixteen channels are reduced to those of the stamp's two.
        """
        detector, frame = self.setting.chip.detector, ReadoutFrame.of(self.setting.chip.detector, self.window)
        states = self.run(base), self.run((*base, name))
        before, after = (s.image.astype(float) + (0 if s.counted is None else s.counted) for s in states)
        mine, inner = [b.channel - 1 for b in frame.blocks], np.s_[:, detector.prescan : -detector.overscan]
        laid = before if before.shape == after.shape else frame.embed(before)
        images = (image[inner] if image.shape == frame.shape else image for image in (before, after, laid))
        header = states[1].header
        channels = {k: [header[k][i] for i in mine] for k in ("bias", "gain") if k in header}
        return *images, header | channels


def find_stamp(setting):
    """Return the first Stamp with all defects and enough cosmic rays."""
    detector = setting.chip.detector
    edges = range(detector.channel_nx, detector.nx // 2, detector.channel_nx)
    places = ((seed, _defective(setting, seed, edge)) for seed in count(1) for edge in edges)
    seed, window = next(place for place in places if place[1])
    stamps = (Stamp(setting, window, seed, str(obsid)) for obsid in count(FIRST))
    return next(stamp for stamp in stamps if stamp.run(("cosmic_rays",)).header["cosmic_tracks"] >= TRACKS)


def _defective(setting, seed, edge):
    """Return a Window across this edge with all kinds of defects, or None."""
    strip = Window(edge - NX + EDGE_INSIDE, edge + NX - EDGE_INSIDE, FIRST_ROW, setting.chip.detector.channel_ny)
    marks = Stamp(setting, strip, seed, str(FIRST)).run(("detector_defects",)).mask
    kinds = [marks & bit > 0 for bit in (mask.HOT, mask.DEAD, mask.BAD_COLUMN)]
    if not all(kind.any() for kind in kinds):
        return None
    core = NY - 2 * INSIDE, NX - 2 * INSIDE
    found = np.argwhere(np.all([sliding_window_view(kind, core).any(axis=(2, 3)) for kind in kinds], axis=0)) - INSIDE
    found = found[(found >= 0).all(axis=1) & (found <= (strip.ny - NY, strip.nx - NX)).all(axis=1)]
    if not len(found):
        return None
    y, x = (found[len(found) // 2] + (strip.y0, strip.x0)).tolist()
    return Window(x, x + NX, y, y + NY)
