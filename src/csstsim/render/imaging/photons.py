"""Photons: objects drawn electron by electron into the counted plane.

An electron's position is that of the object, plus a draw from the profile under its 2 x 2 matrix, plus a draw from the
PSF. The PSF at a position is a mixture of nodes (optics.psf.interpolation), so choosing a node with its weight, and a
sub-band with its fraction of the flux, samples it exactly. The number of electrons of each component is Poisson. If its
mean is small, sub-band and node are chosen for each electron; if it is large, each sub-band and node has an independent
Poisson number. No further Poisson noise is added later.

Losses: numbers are drawn for `maximum` times the light, and an electron on a pixel is detected with probability
response / maximum. A thinned Poisson number is Poisson, so mean = variance holds for every pixel.

Electrons beyond the PSF's box follow the radial wing (optics.scatter.halo) at all radii, also where noise hides it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import high, low, poisson, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.render.photon_positions import (
    CountedImage,
    Profile,
    PsfSampler,
    SceneProfiles,
    check_scene,
    contiguous,
    cumulative,
    first_word,
    from_profile,
    from_psf,
    from_wing,
    pick,
    profiles_of,
    sampler_of,
)

if TYPE_CHECKING:
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.canvas import Canvas
    from csstsim.render.psf_table import PsfTable
    from csstsim.render.scene import Scene

_ONE = np.uint64(1)
_TWO = np.uint64(2)
_MANY = 300.0  # electrons above which numbers are drawn for each (component, sub-band, node)
_BATCH = 512  # electrons drawn at a time; a Poisson number of mean _MANY exceeds it with P < 1e-25
_STRIP = 64  # px: objects of a node are rendered strip by strip, so that their pixels stay in cache


class _Objects(NamedTuple):
    """The arrays of a Scene (n, ...) that compiled loops need; x, y [px of the window]; key: (n,) uint64."""

    x: FloatArray
    y: FloatArray
    matrix: FloatArray
    light: FloatArray
    electrons: FloatArray
    node: IntArray
    weight: FloatArray
    key: IntArray


class _Component(NamedTuple):
    """A component of object number `row`, at x, y [px of the window]."""

    row: int
    x: float
    y: float
    profile: Profile


class _Batch(NamedTuple):
    """Electrons drawn together (_BATCH,): the table of each (`first_word`) and its position [px from the object]."""

    first: IntArray
    px: FloatArray
    py: FloatArray


class Shot(NamedTuple):
    """The electrons of n objects.

    * on_window: (n,) int64, counted on the window
    * outside_box: (n,) int64, outside the PSF's box, drawn for the maximum of the response times the flux
    * box: (n, 4) int64, x0, x1, y0, y1 of the pixels reached, half-open; 0 if none
    """

    on_window: IntArray
    outside_box: IntArray
    box: IntArray


def shoot_scene(canvas: Canvas, scene: Scene, keys: IntArray, table: PsfTable, wing: Wing | None = None) -> Shot:
    """Draw the objects of a Scene into the counted plane of a Canvas, electron by electron.

    The result does not depend on the order of the objects.

    Parameters
    ----------
    canvas
        With a counted plane, int32.
    scene
        n objects.
    keys
        (n,) uint64 of random numbers, all different (base.counter.object_keys).
    table
        With the tables of all PSF nodes of the scene.
    wing
        For the electrons beyond the PSF's box; None: they are dropped.

    Returns
    -------
    Shot
        The electrons of each object; its boxes are of pixels of the chip.

    Raises
    ------
    ValueError
        For arrays of the wrong shape, a response above the maximum, values that are not finite, negative fluxes, 2^31
        electrons in an object, negative weights (a PSF interpolation that is not convex) and nodes without tables.
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
    shot = Shot(np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros((n, 4), np.int64))
    order = np.lexsort((scene.x, np.floor(scene.y / _STRIP), scene.node[:, 0])) if n else np.zeros(0, np.int64)
    objects = _Objects(
        scene.x - window.x0,
        scene.y - window.y0,
        np.ascontiguousarray(scene.matrix, np.float64),
        np.ascontiguousarray(scene.component_fractions, np.float64),
        np.ascontiguousarray(scene.electrons, np.float64),
        np.ascontiguousarray(scene.node),
        np.ascontiguousarray(scene.weight),
        keys,
    )
    image = CountedImage(counted, response, float(maximum))
    _shoot(image, objects, profiles_of(scene), sampler_of(table, wing), shot, order)
    shot.box[shot.on_window > 0] += canvas.corner
    return shot


@numba.njit(cache=True)
def _shoot(
    image: CountedImage, objects: _Objects, profiles: SceneProfiles, psf: PsfSampler, shot: Shot, order: IntArray
) -> None:
    """Draw the objects in an order (n,), and write what was drawn to `shot`."""
    ny, nx = image.counted.shape
    nodes_each = objects.node.shape[1]
    batch = _Batch(np.empty(_BATCH, np.int64), np.empty(_BATCH), np.empty(_BATCH))
    sums = np.empty(4 + nodes_each)
    for i in order:
        key = objects.key[i]
        counter = np.uint64(0)
        shot.box[i] = nx, 0, ny, 0
        bands = cumulative(objects.electrons[i], sums[:4])
        nodes = cumulative(objects.weight[i], sums[4:])
        for c in range(2):
            scale = image.maximum * objects.light[i, c]  # electrons drawn for one of the object
            mean = scale * bands[3]
            profile = Profile(
                objects.matrix[i], profiles.kind[i, c], profiles.fraction[i, c], profiles.radius[i, c], profiles.tables
            )
            component = _Component(i, objects.x[i], objects.y[i], profile)
            if not mean > 0:
                continue
            if mean < _MANY:
                number, counter = poisson(mean, key, counter)
                count, counter = _choose(
                    min(number, _BATCH), bands, nodes, objects.node[i], psf, batch.first, key, counter
                )
                counter = _draw(count, component, image, psf, shot, batch, key, counter)
                counter = _draw_beyond(number - count, component, image, psf, shot, batch, key, counter)
                continue
            lost = 0.0
            for k in range(nodes_each):
                for f in range(4):
                    node = objects.node[i, k]
                    here = scale * objects.electrons[i, f] * objects.weight[i, k]
                    inner = psf.fraction[node, f, 0]
                    outer = psf.fraction[node, f, 1]
                    lost += here * max(1.0 - inner - outer, 0.0)
                    for part in range(2):
                        number, counter = poisson(here * psf.fraction[node, f, part], key, counter)
                        batch.first[: min(number, _BATCH)] = first_word(psf, node, f, part)
                        while number > 0:
                            count = min(number, _BATCH)
                            counter = _draw(count, component, image, psf, shot, batch, key, counter)
                            number -= count
            number, counter = poisson(lost, key, counter)
            counter = _draw_beyond(number, component, image, psf, shot, batch, key, counter)
        if shot.on_window[i] == 0:
            shot.box[i] = 0


@numba.njit(cache=True)
def _choose(
    number: int,
    bands: FloatArray,
    nodes: FloatArray,
    node: IntArray,
    psf: PsfSampler,
    first: IntArray,
    key: np.uint64,
    counter: np.uint64,
) -> tuple[int, np.uint64]:
    """Choose PSF node, sub-band and part for each electron, written to `first` (`first_word`).

    bands (4,), nodes (k,): running sums of the electrons of sub-bands and of the weights of `node` (k,). Returns
    (number inside the PSF's box, counter).
    """
    count = 0
    for _ in range(number):
        which = word(key, counter)
        u = high(word(key, counter + _ONE))
        counter += _TWO
        f = pick(bands, high(which) * bands[3])
        k = pick(nodes, low(which) * nodes[-1])
        inner, outer = psf.fraction[node[k], f]
        first[count] = first_word(psf, node[k], f, np.int64(u >= inner))  # type: ignore[arg-type]  # an int64 is an int to numba
        count += np.int64(u < inner + outer)  # type: ignore[assignment]  # an int64 is an int to numba
    return count, counter


@numba.njit(cache=True)
def _draw(
    count: int,
    component: _Component,
    image: CountedImage,
    psf: PsfSampler,
    shot: Shot,
    batch: _Batch,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Draw and count the electrons whose tables are listed in `batch`; return the counter."""
    from_psf(count, psf, batch.first, batch.px, batch.py, key, counter)
    after = counter + _TWO * np.uint64(count)
    after = from_profile(count, component.profile, batch.px, batch.py, key, after)
    _count(count, component, batch, image, shot, key, counter)
    return after


@numba.njit(cache=True)
def _draw_beyond(
    number: int,
    component: _Component,
    image: CountedImage,
    psf: PsfSampler,
    shot: Shot,
    batch: _Batch,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Draw electrons from the wing beyond the PSF's box, and add their number to `shot`; return the counter."""
    shot.outside_box[component.row] += number
    while number > 0 and psf.tail.size > 0:
        count = min(number, _BATCH)
        after = from_wing(count, psf, batch.px, batch.py, key, counter + _TWO * np.uint64(count))
        after = from_profile(count, component.profile, batch.px, batch.py, key, after)
        _count(count, component, batch, image, shot, key, counter)
        counter = after
        number -= count
    return counter


@numba.njit(cache=True)
def _count(
    count: int,
    component: _Component,
    batch: _Batch,
    image: CountedImage,
    shot: Shot,
    key: np.uint64,
    counter: np.uint64,
) -> None:
    """Count the electrons that fall on the window and are kept."""
    counted = image.counted
    response = image.response
    maximum = image.maximum
    px = batch.px
    py = batch.py
    box = shot.box
    i = component.row
    ny, nx = counted.shape
    # truncation then finds the pixel
    x = component.x + 0.5
    y = component.y + 0.5
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
            detected = np.int64(high(word(key, counter + _TWO * np.uint64(j))) * maximum < seen)
            counted[row, column] += detected
            hit += detected  # type: ignore[assignment]  # an int64 is an int to numba
            x0 = min(x0, np.int64(column))
            x1 = max(x1, np.int64(column))
            y0 = min(y0, np.int64(row))
            y1 = max(y1, np.int64(row))
    shot.on_window[i] += hit
    box[i, 0] = x0
    box[i, 1] = x1 + 1
    box[i, 2] = y0
    box[i, 3] = y1 + 1
