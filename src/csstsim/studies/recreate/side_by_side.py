"""Two frames of the same objects compared by positions, fluxes, background and noise, where bits cannot agree.

An object's flux is the sum in the same circle in both frames, its position the windowed centroid, both by sep. The
noise of both frames follows from the background, so each mean has an error.
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

# largest difference that counts as the same: px, and relative
POSITION_TOLERANCE = 0.02
FLUX_TOLERANCE = 0.005
LEVEL_TOLERANCE = 0.01
# px: radius of the circle for fluxes, sigma of the centroid's window
RADIUS = 6.0
SIGMA = 1.5
LEVELS = "background [e-]", "noise [e-]"  # compared without objects
# minimum S/N of objects for fluxes, for positions
SNR_FLUX = 20.0
SNR_POSITION = 100.0
_EDGE = 12  # px, minimum distance from the edge of the window
_SIGMAS_OF_ERROR = 2.0  # errors beyond the tolerance at which a difference counts
DIFFERS = "DIFFERS"
_SIGMAS_CLIPPED = 5.0  # sigmas from the median of the others: a cosmic ray in one of the frames


@dataclass(frozen=True)
class Line:
    """One comparison: what; the numbers of A and B as text; the difference, its error and the largest one allowed."""

    what: str
    words: str
    difference: float
    error: float
    allowed: float

    @property
    def verdict(self) -> str:
        """`same`, DIFFERS, or that the error is too large to tell."""
        beyond = abs(self.difference) - self.allowed
        return "same" if beyond <= 0 else "cannot be told" if beyond <= _SIGMAS_OF_ERROR * self.error else DIFFERS


def side_by_side(
    a: PathLike, b: PathLike, truth: PathLike, log: Callable[[str], object], instrument: PathLike | None = None
) -> int:
    """Log the comparison of two frames at a catalogue's objects; return how many lines differ by more than allowed.

    If no object can be compared, one more line reports this and counts.

    a, b: FITS files of one chip; truth: `.cat` or truth parquet with positions on the image. Raises InputError.
    """
    lines = compare_frames(a, b, truth, instrument)
    for line in lines:
        log(f"{line.what:<24} {line.words}  difference {line.difference:+.4f} +- {line.error:.4f}  {line.verdict}")
    differing = sum(line.verdict == DIFFERS for line in lines)
    if lines[-1].what in LEVELS and not _slitless(a, instrument):
        log(f"no object of {truth} could be compared: none is bright and clean enough in both frames")
        differing += 1
    return differing


def compare_frames(a: PathLike, b: PathLike, truth: PathLike, instrument: PathLike | None = None) -> list[Line]:
    """Return the Lines of the comparison; see `side_by_side`. For slitless chips, only of background and noise."""
    camera = load_camera(instrument)
    objects = read_objects(truth)
    if not {"x", "y"} <= set(objects):
        raise InputError("the catalogue lacks positions on the image", file=truth, key="xImage, yImage")
    headers = [read_frame(path) for path in (a, b)]
    chips = [header.chip for header in headers]
    if chips[0] != chips[1] or chips[0] not in camera.chips:
        raise InputError(
            "not frames of one chip of the camera", file=b, key="DETECTOR", value=chips[1], allowed=chips[0]
        )
    frames = [read_electrons(header, camera.detector) for header in headers]
    windows = np.array([frame.window for frame in frames])
    if (windows[:, [0, 2]].max(axis=0) >= windows[:, [1, 3]].min(axis=0)).any():
        raise InputError("the windows of the frames do not overlap", file=b, value=str(frames[1].window))
    (x0, y0), (x1, y1) = windows[:, [0, 2]].max(axis=0), windows[:, [1, 3]].min(axis=0)
    overlaps = [(slice(y0 - window[2], y1 - window[2]), slice(x0 - window[0], x1 - window[0])) for window in windows]
    saturated = frames[0].saturated[overlaps[0]] | frames[1].saturated[overlaps[1]]
    images = [np.ascontiguousarray(frame.electrons[overlap]) for frame, overlap in zip(frames, overlaps, strict=True)]
    levels = [clipped(image[~saturated]) for image in images]
    if camera.chips[chips[0]].kind == "slitless":  # light is dispersed: none is at an object's position
        return list(_backgrounds(levels, (~saturated).sum()))
    compared = _Objects(images, saturated, levels, objects["x"] - x0, objects["y"] - y0, objects["obj_type"])
    return [*_backgrounds(levels, (~saturated).sum()), *compared.fluxes(), *compared.positions()]


def _slitless(path: PathLike, instrument: PathLike | None) -> bool:
    return load_camera(instrument).chips[read_frame(path).chip].kind == "slitless"


def _backgrounds(levels: Sequence[Level], count: int) -> Iterator[Line]:
    first, second = levels
    for what, value_a, value_b in zip(LEVELS, first, second, strict=True):  # both have the order mean, sigma
        scale = max(abs(value_a), 1.0)  # relative to at least one electron
        error = np.hypot(first.sigma, second.sigma) / np.sqrt(count) / scale
        yield Line(what, f"{value_a:9.3f} {value_b:9.3f}", (value_b - value_a) / scale, float(error), LEVEL_TOLERANCE)


class _Objects:
    """The objects' fluxes and positions in two images of one window; x, y [px] in it."""

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
        self._x, self._y, self._kinds = (np.ascontiguousarray(values[inside]) for values in (x, y, kinds))
        subtracted = [image - np.float32(level.mean) for image, level in zip(images, levels, strict=True)]
        sums = [sep.sum_circle(image, self._x, self._y, RADIUS, mask=saturated) for image in subtracted]
        self._flux = np.array([flux for flux, _, _ in sums])
        area = np.pi * RADIUS**2
        self._noise = np.sqrt(np.maximum(self._flux, 0) + area * np.array([[level.sigma**2] for level in levels]))
        self._clean = (sums[0][2] == 0) & (sums[1][2] == 0)
        self._snr = (self._flux / self._noise).min(axis=0)
        self._images = subtracted

    def fluxes(self) -> Iterator[Line]:
        """Yield the Lines of fluxes, of points and of galaxies: the sum of B over that of A."""
        for kind, of_kind in (("points", self._kinds != GALAXY), ("galaxies", self._kinds == GALAXY)):
            selected = self._clean & of_kind & (self._snr > SNR_FLUX)
            flux_a, flux_b = self._flux[:, selected]
            error = np.hypot(*self._noise[:, selected])
            inliers = _without_outliers((flux_b - flux_a) / error) if selected.any() else selected[:0]
            if inliers.any():
                total = flux_a[inliers].sum()
                difference = (flux_b - flux_a)[inliers].sum()
                words = f"{total:9.4g} {total + difference:9.4g}  of {inliers.sum()}"
                total_error = np.sqrt((error[inliers] ** 2).sum())
                yield Line(f"flux of {kind} [e-]", words, difference / total, total_error / total, FLUX_TOLERANCE)

    def positions(self) -> Iterator[Line]:
        """Yield the Lines of positions of bright objects: mean differences along x and y, and the median distance."""
        import sep

        selected = self._clean & (self._snr > SNR_POSITION)
        if not selected.any():
            return
        x = self._x[selected]
        y = self._y[selected]
        centroids = [sep.winpos(image, x, y, np.full(len(x), SIGMA), subpix=0) for image in self._images]
        dx, dy = (centroids[1][k] - centroids[0][k] for k in (0, 1))
        inliers = _without_outliers(dx) & _without_outliers(dy)
        count = f"of {inliers.sum()}"
        for axis, differences in (("x", dx[inliers]), ("y", dy[inliers])):
            error = differences.std() / np.sqrt(len(differences))
            mean = float(differences.mean())
            yield Line(f"positions along {axis} [px]", f"{count:>22}", mean, float(error), POSITION_TOLERANCE)
        distance = np.hypot(dx[inliers], dy[inliers])
        yield Line("positions, median [px]", f"{count:>22}", float(np.median(distance)), 0.0, POSITION_TOLERANCE)


def _without_outliers(values: FloatArray) -> BoolArray:
    """Return the mask of values within 5 robust sigmas of their median; all where half of them are the same."""
    deviation = np.abs(values - np.median(values))
    sigma = sigma_of_deviations(deviation)
    return deviation <= _SIGMAS_CLIPPED * sigma if sigma > 0 else np.ones(len(deviation), bool)
