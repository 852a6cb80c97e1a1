"""Models of close sources, with which each is measured on the image without the light of the others.

Sources whose light overlaps are neighbours. They get colours, so that no two neighbours have the same. Sources of one
colour are measured together, on the image from which the models of all other colours are subtracted: first the models,
ROUNDS times, then all columns of the catalogue.

A model is the most probable profile of measure.light.total_light, of a point or a galaxy, on the ellipse of the
source's adaptive moments. A point is the PSF itself in the stamp of its fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Self

import numba
import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.measure.light.photometry import HALF, SourcePsfs, render_psf

if TYPE_CHECKING:
    from csstsim.measure.detection.combine import Detections
    from csstsim.measure.light.profile_tables import ProfileTables
    from csstsim.measure.light.total_light import LightModels

# Distance of neighbours: px; half-light radii of either
LINK = 12.0
LINK_SIZES = 2.0
LINK_MAX = 60.0  # px
ROUNDS = 2
FAINTEST = 0.02  # electron / px: a model ends where it is fainter


class _Models(NamedTuple):
    """Models of the sources (n,): position [px], flux [electron] times `profile` (n, K) at `nodes` (K,) of r^2 [px^2].

    `e1`, `e2`: distortion of the ellipses on which the profile is constant; `point`: the PSF `psf` in its stamp.
    """

    x: FloatArray
    y: FloatArray
    flux: FloatArray
    profile: FloatArray
    point: BoolArray
    e1: FloatArray
    e2: FloatArray
    nodes: FloatArray


@dataclass(frozen=True)
class Neighbours:
    """The sources with neighbours of a catalogue, and their models; `colour` (n,): -1 for others."""

    image: FloatArray
    colour: IntArray
    models: _Models
    psf: SourcePsfs

    @classmethod
    def of(cls, found: Detections, table: Mapping[str, AnyArray], psf: SourcePsfs, tables: ProfileTables) -> Self:
        """Return the Neighbours of `found`: sources without an isophote of their own are points at first.

        table: has x, y (px of the chip), flux_psf, hsm_e1, hsm_e2 of the sources; psf: theirs.
        """
        e1, e2 = (np.nan_to_num(table[name]).astype(float) for name in ("hsm_e1", "hsm_e2"))
        flux = np.maximum(np.nan_to_num(table["flux_psf"]), 0.0)
        # Extended sources first: without the points in them they are nearly right, and points without them are not
        order = np.lexsort((-flux, ~found.extended))
        profile = tables.point[tables.part(table["x"], table["y"]), :, 0].astype(float)
        models = _Models(
            found.x.copy(), found.y.copy(), np.where(found.extended, 0.0, flux), profile, ~found.extended, e1, e2,
            tables.nodes,
        )  # fmt: skip
        return cls(found.image, _colours(found.x, found.y, found.half_light, order), models, psf)

    def subtract(self) -> None:
        """Subtract all models from the image."""
        self._add(np.flatnonzero(self.colour >= 0), -1.0)

    def each_colour(self, measure: Callable[[IntArray], None]) -> None:
        """Call `measure` with the rows of each colour, while the models of all others are subtracted."""
        for colour in range(self.colour.max(initial=-1) + 1):
            rows = np.flatnonzero(self.colour == colour)
            self._add(rows, 1.0)
            measure(rows)
            self._add(rows, -1.0)

    def model(self, rows: IntArray, x: FloatArray, y: FloatArray, light: LightModels) -> None:
        """Set the models of rows."""
        for array, values in zip(self.models, (x, y, *light), strict=False):
            array[rows] = values

    def restore(self) -> None:
        """Add all models to the image again."""
        self._add(np.flatnonzero(self.colour >= 0), 1.0)

    def left(self, rows: IntArray, model: Callable[[IntArray], LightModels]) -> FloatArray:
        """Return the image without the models of rows; `model`: of those without neighbours."""
        alone = rows[self.colour[rows] < 0]
        self.model(alone, self.models.x[alone], self.models.y[alone], model(alone))
        image = self.image.copy()
        _add_models(image, rows, self.models, self.psf, -1.0)
        return image

    def _add(self, rows: IntArray, factor: float) -> None:
        _add_models(self.image, rows, self.models, self.psf, factor)


def _colours(x: FloatArray, y: FloatArray, half_light: FloatArray, order: IntArray) -> IntArray:
    """Return (n,): numbers that differ between neighbours, the smallest possible in the `order` of rows; -1 without."""
    from scipy.spatial import cKDTree

    if not len(x):
        return np.zeros(0, int)
    places = np.column_stack([x, y])
    reach = np.clip(LINK_SIZES * np.nan_to_num(half_light), LINK, LINK_MAX)
    near = cKDTree(places).query_ball_point(places, reach)
    first = np.repeat(np.arange(len(x)), [len(some) for some in near])
    second = np.concatenate([np.asarray(some, int) for some in near])
    apart = first != second
    pairs = np.stack([first[apart], second[apart]])
    pairs = np.unique(np.concatenate([pairs, pairs[::-1]], axis=1), axis=1)
    start = np.searchsorted(pairs[0], np.arange(len(x) + 1))
    return _greedy(order, start, np.ascontiguousarray(pairs[1]))


@numba.njit(cache=True)
def _greedy(order: IntArray, start: IntArray, others: IntArray) -> IntArray:
    """Return the colour of each source; others[start[k]:start[k + 1]]: the neighbours of source k."""
    colour = np.full(order.size, -1)
    for k in order:
        if start[k] == start[k + 1]:
            continue
        taken = np.zeros(start[k + 1] - start[k] + 1, np.bool_)
        for j in others[start[k] : start[k + 1]]:
            if 0 <= colour[j] < taken.size:
                taken[colour[j]] = True
        free = 0
        while taken[free]:
            free += 1
        colour[k] = free
    return colour


@numba.njit(cache=True)
def _add_models(image: FloatArray, rows: IntArray, models: _Models, psf: SourcePsfs, factor: float) -> None:
    """Add `factor` times the models of rows to the image."""
    ny, nx = image.shape
    nodes = models.nodes
    stamp = np.empty((2 * HALF + 1, 2 * HALF + 1))
    for k in rows:
        flux = models.flux[k]
        if not flux > 0.0:
            continue
        profile = models.profile[k]
        last = 1
        while last < nodes.size - 1 and flux * profile[last] > FAINTEST:
            last += 1
        x = models.x[k]
        y = models.y[k]
        column = round(x)
        row = round(y)
        if models.point[k]:
            render_psf(psf.coefficients[psf.cell[k]], psf.per_pixel, x - column, y - row, stamp)
        e1 = 0.0 if models.point[k] else models.e1[k]
        e2 = 0.0 if models.point[k] else models.e2[k]
        area = np.sqrt(max(1.0 - e1 * e1 - e2 * e2, 0.05))
        reach_x = np.sqrt(nodes[last] * (1.0 + e1) / area)
        reach_y = np.sqrt(nodes[last] * (1.0 - e1) / area)
        for j in range(max(int(np.ceil(y - reach_y)), 0), min(int(y + reach_y) + 1, ny)):
            dy = j - y
            i = 0
            for c in range(max(int(np.ceil(x - reach_x)), 0), min(int(x + reach_x) + 1, nx)):
                dx = c - x
                if models.point[k] and abs(c - column) <= HALF and abs(j - row) <= HALF:
                    value = stamp[j - row + HALF, c - column + HALF]
                else:
                    r2 = ((1.0 - e1) * dx * dx - 2.0 * e2 * dx * dy + (1.0 + e1) * dy * dy) / area
                    if r2 >= nodes[last]:
                        continue
                    while nodes[i + 1] <= r2:
                        i += 1
                    while nodes[i] > r2:
                        i -= 1
                    t = (r2 - nodes[i]) / (nodes[i + 1] - nodes[i])
                    value = (1.0 - t) * profile[i] + t * profile[i + 1]
                image[j, c] += factor * flux * value


def measured_apart(
    found: Detections,
    table: dict[str, AnyArray],
    neighbours: Neighbours,
    model: Callable[[IntArray], LightModels],
    measure: Callable[[IntArray], Mapping[str, AnyArray]],
) -> None:
    """Replace the rows of `table` of sources with neighbours by those measured without the light of the others.

    model, measure: functions of rows of `found` that return LightModels, and the columns of the table, of its image.
    """

    def fit(rows: IntArray) -> None:
        neighbours.model(rows, found.x[rows], found.y[rows], model(rows))

    def replace_rows(rows: IntArray) -> None:
        for name, values in measure(rows).items():
            table[name][rows] = values

    neighbours.subtract()
    for _ in range(ROUNDS):
        neighbours.each_colour(fit)
    neighbours.each_colour(replace_rows)
    neighbours.restore()
