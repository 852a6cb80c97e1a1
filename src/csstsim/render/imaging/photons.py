"""Photons: objects drawn electron by electron into the counted plane.

An electron's position is that of the object, plus a draw from the profile under its 2 x 2 matrix, plus a draw from the
PSF. The PSF at a position is a mixture of nodes (optics.psf.interpolation), so choosing a node with its weight, and a
sub-band with its share of the light, samples it exactly. The number of electrons of each component is Poisson. If its
mean is small, sub-band and node are chosen for each electron; if it is large, each sub-band and node has an independent
Poisson number. No further Poisson noise is added later.

Losses: numbers are drawn for `maximum` times the light, and an electron on a pixel is kept with probability
response / maximum. A thinned Poisson number is Poisson, so mean = variance holds for every pixel.

Electrons beyond the PSF's box follow the radial wing (optics.scatter.halo) at all radii, also where noise hides it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numba
import numpy as np

from csstsim.base.counter import high, low, poisson, word
from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.render.photon_positions import (
    Cells,
    Shapes,
    check_scene,
    contiguous,
    cumulative,
    first_word,
    from_profile,
    from_psf,
    from_wing,
    pick,
    profiles_of,
    tail_table,
)

if TYPE_CHECKING:
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.canvas import Canvas
    from csstsim.render.psf_table import PsfTable
    from csstsim.render.scene import Scene

# What compiled loops pass on: counted, response and maximum; of an object x, y, matrix, profile, shapes and row;
# on_window, outside_box and box; of each electron first word, px and py
Image: TypeAlias = tuple[IntArray, FloatArray, float]
Place: TypeAlias = tuple[float, float, FloatArray, FloatArray, Shapes, int]
Results: TypeAlias = tuple[IntArray, IntArray, IntArray]
Work: TypeAlias = tuple[IntArray, FloatArray, FloatArray]
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_MANY = 300.0  # electrons above which numbers are drawn for each (component, sub-band, node)
_BATCH = 512  # electrons drawn at a time; a Poisson number of mean _MANY exceeds it with P < 1e-25
_STRIP = 64  # px: objects of a node are drawn strip by strip, so that their pixels stay in cache


def shoot_scene(
    canvas: Canvas, scene: Scene, keys: IntArray, table: PsfTable, wing: Wing | None = None
) -> tuple[IntArray, IntArray, IntArray]:
    """Draw the objects of a Scene into the counted plane of a Canvas, which must be there.

    keys: (n,) uint64, all different (counter.object_keys). table: PsfTable with the tables of all nodes of the scene.
    wing: optics.scatter.halo.Wing for the electrons beyond the PSF's box, or None: they are dropped.

    Returns on_window (n,) int64, electrons counted; outside_box (n,) int64, electrons outside the PSF's box, drawn for
    `canvas.maximum` times the light; box (n, 4) int64, x0, x1, y0, y1 of the chip's pixels reached, half-open, 0 if
    none. The result does not depend on the order of the objects. Raises ValueError for arrays of the wrong shape, a
    response above the maximum, values that are not finite, negative light, 2^31 electrons in an object, negative
    weights (a PSF interpolation that is not convex) and nodes without tables.
    """
    counted = canvas.counted
    window = canvas.window
    maximum = canvas.maximum
    assert counted is not None
    if counted.shape != window.shape or counted.dtype != np.int32:
        raise ValueError(f"counted is {counted.dtype} {counted.shape}, not int32 {window.shape}")
    check_scene(scene, table, maximum)
    response = contiguous(canvas.response)
    if response.size and (response.shape != window.shape or not response.max() <= maximum * (1 + 1e-6)):
        raise ValueError(f"the response must be {window.shape} and at most {maximum}")
    n = len(scene)
    on_window = np.zeros(n, np.int64)
    outside_box = np.zeros(n, np.int64)
    box = np.zeros((n, 4), np.int64)
    order = np.lexsort((scene.x, np.floor(scene.y / _STRIP), scene.node[:, 0])) if n else np.zeros(0, np.int64)
    profile, shapes = profiles_of(scene)
    floats = (scene.matrix, scene.light, profile, scene.electrons)
    objects: tuple[AnyArray, ...]
    objects = scene.x - window.x0, scene.y - window.y0, *(np.ascontiguousarray(a, np.float64) for a in floats)
    objects += np.ascontiguousarray(scene.node), np.ascontiguousarray(scene.weight), keys
    psf = table.words.reshape(-1), table.share, table.bits, table.cells, table.per_pixel
    tail = np.empty(0) if wing is None else tail_table(wing, table.cells / table.per_pixel / 2)
    _shoot((counted, response, float(maximum)), objects, shapes, psf, tail, (on_window, outside_box, box), order)
    box[on_window > 0] += canvas.corner
    return on_window, outside_box, box


@numba.njit(cache=True)
def _shoot(
    image: Image,
    objects: tuple[AnyArray, ...],
    shapes: Shapes,
    psf: Cells,
    tail: FloatArray,
    results: Results,
    order: IntArray,
) -> None:
    counted, _, maximum = image
    x, y, matrix, light, profile, electrons, index, weight, keys = objects
    share = psf[1]
    sides = psf[2]
    on_window, _, box = results
    work = np.empty(_BATCH, np.int64), np.empty(_BATCH), np.empty(_BATCH)
    sums = np.empty(4 + index.shape[1])
    for i in order:
        key = keys[i]
        counter = np.uint64(0)
        box[i] = counted.shape[1], 0, counted.shape[0], 0
        bands = cumulative(electrons[i], sums[:4])
        nodes = cumulative(weight[i], sums[4:])
        for c in range(2):
            mean = maximum * light[i, c] * bands[3]
            place = x[i], y[i], matrix[i], profile[i, c], shapes, i
            if not mean > 0:
                continue
            if mean < _MANY:
                number, counter = poisson(mean, key, counter)
                count, counter = _choose(min(number, _BATCH), bands, nodes, index[i], share, sides, key, counter, work)
                counter = _draw(count, place, image, psf, results, work, key, counter)
                counter = _draw_beyond(number - count, place, image, psf, tail, results, work, key, counter)
                continue
            lost = 0.0
            for k in range(index.shape[1]):
                for f in range(4):
                    node = index[i, k]
                    here = maximum * light[i, c] * electrons[i, f] * weight[i, k]
                    lost += here * max(1.0 - share[node, f, 0] - share[node, f, 1], 0.0)
                    for part in range(2):
                        number, counter = poisson(here * share[node, f, part], key, counter)
                        work[0][: min(number, _BATCH)] = first_word(node, f, part, sides)
                        while number > 0:
                            count = min(number, _BATCH)
                            counter = _draw(count, place, image, psf, results, work, key, counter)
                            number -= count
            number, counter = poisson(lost, key, counter)
            counter = _draw_beyond(number, place, image, psf, tail, results, work, key, counter)
        if on_window[i] == 0:
            box[i] = 0


@numba.njit(cache=True)
def _choose(
    number: int,
    bands: FloatArray,
    nodes: FloatArray,
    index: IntArray,
    share: FloatArray,
    sides: tuple[int, int],
    key: np.uint64,
    counter: np.uint64,
    work: Work,
) -> tuple[int, np.uint64]:
    """Choose node, sub-band and part for each electron; return (number inside the PSF's box, counter)."""
    first = work[0]
    count = 0
    for _ in range(number):
        which = word(key, counter)
        u = high(word(key, counter + _ONE))
        counter += _TWO
        f = pick(bands, high(which) * bands[3])
        k = pick(nodes, low(which) * nodes[-1])
        inner, outer = share[index[k], f]
        first[count] = first_word(index[k], f, np.int64(u >= inner), sides)  # type: ignore[arg-type]  # an int64 is an int to numba
        count += np.int64(u < inner + outer)  # type: ignore[assignment]  # an int64 is an int to numba
    return count, counter


@numba.njit(cache=True)
def _draw(
    count: int, place: Place, image: Image, psf: Cells, results: Results, work: Work, key: np.uint64, counter: np.uint64
) -> np.uint64:
    """Draw and count the electrons whose tables are listed in `work`; return the counter."""
    x, y, matrix, profile, shapes, i = place
    first, px, py = work
    from_psf(count, psf, first, px, py, key, counter)
    after = counter + _TWO * np.uint64(count)
    after = from_profile(count, matrix, profile, shapes, px, py, key, after)
    _count(count, x, y, px, py, image, results, i, key, counter)
    return after


@numba.njit(cache=True)
def _draw_beyond(
    number: int,
    place: Place,
    image: Image,
    psf: Cells,
    tail: FloatArray,
    results: Results,
    work: Work,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Draw electrons from the wing beyond the PSF's box, and add their number to `results`; return the counter."""
    x, y, matrix, profile, shapes, i = place
    _, px, py = work
    results[1][i] += number
    half = 0.5 * psf[3] / psf[4]
    while number > 0 and tail.size > 0:
        count = min(number, _BATCH)
        after = from_wing(count, tail, half, px, py, key, counter + _TWO * np.uint64(count))
        after = from_profile(count, matrix, profile, shapes, px, py, key, after)
        _count(count, x, y, px, py, image, results, i, key, counter)
        counter = after
        number -= count
    return counter


@numba.njit(cache=True)
def _count(
    count: int,
    x: float,
    y: float,
    px: FloatArray,
    py: FloatArray,
    image: Image,
    results: Results,
    i: int,
    key: np.uint64,
    counter: np.uint64,
) -> None:
    """Count the electrons that fall on the window and are kept."""
    counted, response, maximum = image
    on_window, _, box = results
    ny, nx = counted.shape
    # truncation then finds the pixel
    x = x + 0.5
    y = y + 0.5
    hit = 0
    x0 = box[i, 0]
    x1 = box[i, 1] - 1
    y0 = box[i, 2]
    y1 = box[i, 3] - 1
    for j in range(count):
        u = px[j] + x
        v = py[j] + y
        if u >= 0 and v >= 0 and u < nx and v < ny:
            column = np.uint64(np.int64(u))
            row = np.uint64(np.int64(v))
            seen = response[row, column] if response.size > 0 else np.float32(1.0)
            kept = np.int64(high(word(key, counter + _TWO * np.uint64(j))) * maximum < seen)
            counted[row, column] += kept
            hit += kept  # type: ignore[assignment]  # an int64 is an int to numba
            x0 = min(x0, np.int64(column))
            x1 = max(x1, np.int64(column))
            y0 = min(y0, np.int64(row))
            y1 = max(y1, np.int64(row))
    on_window[i] += hit
    box[i, 0] = x0
    box[i, 1] = x1 + 1
    box[i, 2] = y0
    box[i, 3] = y1 + 1
