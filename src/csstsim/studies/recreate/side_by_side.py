"""Two frames of the same objects side by side: places, light, background and noise, where bits cannot agree.

Each object's light is summed in the same circle in both frames, and its place is the windowed centroid, by sep. The
noise of both frames is known from the background, so each mean has its error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import sigma_of_deviations
from csstsim.base.errors import InputError
from csstsim.catalog.table import GALAXY
from csstsim.instrument.camera import load_camera
from csstsim.studies.recreate.frame import read_frame
from csstsim.studies.recreate.objects import read_objects
from csstsim.studies.recreate.pixels import Level, clipped, read_electrons

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from csstsim.base.types import BoolArray, FloatArray, IntArray, PathLike

# what counts as the same: px, and relative
PLACE_PX = 0.02
LIGHT = 0.005
LEVEL = 0.01
# px: of the circle of light, of the centroid's window
RADIUS = 6.0
SIGMA = 1.5
LEVELS = "background [e-]", "noise [e-]"  # compared without objects
# S/N of objects whose light, whose place is compared
SEEN = 20.0
BRIGHT = 100.0
_EDGE = 12  # px from the border of what was read
# errors beyond what is allowed
_TOLD = 2.0
DIFFERS = "DIFFERS"
_OUT = 5.0  # sigmas from the median of the others: a cosmic ray in one of the frames


@dataclass(frozen=True)
class Line:
    """One comparison: what, the numbers of A and B in words, the difference, its error and what is allowed."""

    what: str
    words: str
    difference: float
    error: float
    allowed: float

    @property
    def verdict(self) -> str:
        """In a word: `same`, DIFFERS, or that the error is too large to tell."""
        beyond = abs(self.difference) - self.allowed
        return "same" if beyond <= 0 else "cannot be told" if beyond <= _TOLD * self.error else DIFFERS


def side_by_side(
    a: PathLike, b: PathLike, truth: PathLike, log: Callable[[str], object], instrument: PathLike | None = None
) -> int:
    """Print the comparison of two frames at a catalogue's objects; return how many lines differ by more than allowed.

    That no object could be compared is a line, too, and counts.

    a, b: FITS files of one chip; truth: `.cat` or truth parquet with places on the image. Raises InputError.
    """
    lines = compared(a, b, truth, instrument)
    for line in lines:
        log(f"{line.what:<24} {line.words}  difference {line.difference:+.4f} +- {line.error:.4f}  {line.verdict}")
    differing = sum(line.verdict == DIFFERS for line in lines)
    if lines[-1].what in LEVELS and not _slitless(a, instrument):
        log(f"no object of {truth} could be compared: none is bright and clean enough in both frames")
        differing += 1
    return differing


def compared(a: PathLike, b: PathLike, truth: PathLike, instrument: PathLike | None = None) -> list[Line]:
    """Return the Lines of the comparison; see `side_by_side`. Behind gratings, of background and noise alone."""
    camera = load_camera(instrument)
    objects = read_objects(truth)
    if not {"x", "y"} <= set(objects):
        raise InputError("the catalogue lacks places on the image", file=truth, key="xImage, yImage")
    heads = [read_frame(path) for path in (a, b)]
    chips = [head.chip for head in heads]
    if chips[0] != chips[1] or chips[0] not in camera.chips:
        raise InputError(
            "not frames of one chip of the camera", file=b, key="DETECTOR", value=chips[1], allowed=chips[0]
        )
    frames = [read_electrons(head, camera.detector) for head in heads]
    windows = np.array([frame.window for frame in frames])
    if (windows[:, [0, 2]].max(axis=0) >= windows[:, [1, 3]].min(axis=0)).any():
        raise InputError("the frames were read in windows apart", file=b, value=str(frames[1].window))
    (x0, y0), (x1, y1) = windows[:, [0, 2]].max(axis=0), windows[:, [1, 3]].min(axis=0)
    parts = [(slice(y0 - w[2], y1 - w[2]), slice(x0 - w[0], x1 - w[0])) for w in windows]
    saturated = frames[0].saturated[parts[0]] | frames[1].saturated[parts[1]]
    images = [np.ascontiguousarray(frame.electrons[part]) for frame, part in zip(frames, parts, strict=True)]
    levels = [clipped(image[~saturated]) for image in images]
    if camera.chips[chips[0]].kind == "slitless":  # no object's light is at its place
        return list(_backgrounds(levels, (~saturated).sum()))
    seen = _Objects(images, saturated, levels, objects["x"] - x0, objects["y"] - y0, objects["obj_type"])
    return [*_backgrounds(levels, (~saturated).sum()), *seen.light(), *seen.places()]


def _slitless(path: PathLike, instrument: PathLike | None) -> bool:
    return load_camera(instrument).chips[read_frame(path).chip].kind == "slitless"


def _backgrounds(levels: Sequence[Level], count: int) -> Iterator[Line]:
    first, second = levels
    for what, one, other in zip(LEVELS, first, second, strict=True):  # both have the order mean, sigma
        unit = max(abs(one), 1.0)  # a difference counts relative to one electron at least
        error = np.hypot(first.sigma, second.sigma) / np.sqrt(count) / unit
        yield Line(what, f"{one:9.3f} {other:9.3f}", (other - one) / unit, float(error), LEVEL)


class _Objects:
    """The objects' light and places in two images of one window; x, y [px] in it."""

    def __init__(
        self,
        images: Sequence[FloatArray],
        saturated: BoolArray,
        levels: Sequence[Level],
        x: FloatArray,
        y: FloatArray,
        kinds: IntArray,
    ) -> None:
        import sep

        ny, nx = images[0].shape
        inside = (x > _EDGE) & (x < nx - 1 - _EDGE) & (y > _EDGE) & (y < ny - 1 - _EDGE)
        self._x, self._y, self._kinds = (np.ascontiguousarray(v[inside]) for v in (x, y, kinds))
        dark = [image - np.float32(level.mean) for image, level in zip(images, levels, strict=True)]
        sums = [sep.sum_circle(image, self._x, self._y, RADIUS, mask=saturated) for image in dark]
        self._light = np.array([flux for flux, _, _ in sums])
        area = np.pi * RADIUS**2
        self._noise = np.sqrt(np.maximum(self._light, 0) + area * np.array([[level.sigma**2] for level in levels]))
        self._clean = (sums[0][2] == 0) & (sums[1][2] == 0)
        self._snr = (self._light / self._noise).min(axis=0)
        self._dark = dark

    def light(self) -> Iterator[Line]:
        """Yield the Lines of light, of points and of galaxies: the sum of B over that of A."""
        for kind, those in (("points", self._kinds != GALAXY), ("galaxies", self._kinds == GALAXY)):
            some = self._clean & those & (self._snr > SEEN)
            one, other = self._light[:, some]
            error = np.hypot(*self._noise[:, some])
            kept = _without_outliers((other - one) / error) if some.any() else some[:0]
            if kept.any():
                total = one[kept].sum()
                off = (other - one)[kept].sum()
                words = f"{total:9.4g} {total + off:9.4g}  of {kept.sum()}"
                yield Line(
                    f"light of {kind} [e-]", words, off / total, np.sqrt((error[kept] ** 2).sum()) / total, LIGHT
                )

    def places(self) -> Iterator[Line]:
        """Yield the Lines of places: mean differences along x and y, and the scatter of those of bright objects."""
        import sep

        some = self._clean & (self._snr > BRIGHT)
        if not some.any():
            return
        found = [sep.winpos(i, self._x[some], self._y[some], np.full(some.sum(), SIGMA), subpix=0) for i in self._dark]
        dx, dy = (found[1][k] - found[0][k] for k in (0, 1))
        kept = _without_outliers(dx) & _without_outliers(dy)
        number = f"of {kept.sum()}"
        for axis, off in (("x", dx[kept]), ("y", dy[kept])):
            error = off.std() / np.sqrt(len(off))
            yield Line(f"places along {axis} [px]", f"{number:>22}", float(off.mean()), float(error), PLACE_PX)
        apart = np.hypot(dx[kept], dy[kept])
        yield Line("places, median [px]", f"{number:>22}", float(np.median(apart)), 0.0, PLACE_PX)


def _without_outliers(values: FloatArray) -> BoolArray:
    """Return the mask of values within 5 robust sigmas of their median; all where half of them are the same."""
    off = np.abs(values - np.median(values))
    sigma = sigma_of_deviations(off)
    return off <= _OUT * sigma if sigma > 0 else np.ones(len(off), bool)
