"""Objects of several parts: rows added to a Scene for knots, and for images and the tiles of large ones.

A row of a Scene has one position, one matrix and one fraction of its object's electrons. The first rows are the
objects, in their order, as they are without parts. Knots are a row of their own. An image takes its object's row; if it
covers many pixels it is cut in tiles, each with the PSF of its own position and a transform of moderate size.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import word
from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.catalog.galaxy_shapes.components import has_image
from csstsim.catalog.galaxy_shapes.images import read_image, sky_of
from csstsim.catalog.galaxy_shapes.knots import knots_of
from csstsim.catalog.selection.reach import POINT_MAX, POINT_MIN
from csstsim.render.parts.spots import Spots, image_coefficients

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from csstsim.catalog.galaxy_shapes.knots import Knots
    from csstsim.catalog.table import ObjectTable
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.render.scene import Scene

TILE_PX = 384.0  # pixels of the chip: the longest side of an image, or of a tile of one
_PART = np.uint64(1) << np.uint64(40)  # a word of the keys of parts: beyond those of twins (render.imaging.draw)


def with_parts(scene: Scene, objects: ObjectTable, psf: PsfSet, lens: Callable[[IntArray], FloatArray]) -> Scene:
    """Return the Scene of objects with the rows of their knots and images; the same Scene if there are none.

    objects: the ObjectTable of which `scene` has one row each; lens(rows) -> (m, 2, 2) pixel per arcsec of the sky
    before lensing.
    """
    knots = knots_of(objects)
    pictured = np.flatnonzero(has_image(objects))
    if not len(knots.rows) and not len(pictured):
        return scene
    n = len(scene)
    images, tiles = _tiles(objects, pictured, lens)
    spots = Spots(knots.counts, knots.u, knots.v, images)
    fraction = np.ones(n)
    components = scene.component_fractions.copy()
    fraction[knots.rows] = 1.0 - knots.fraction
    components[knots.rows, 0] = np.maximum(components[knots.rows, 0] - knots.fraction, 0.0)  # the disk's include them
    total = components[knots.rows].sum(axis=1, keepdims=True)
    scaled = components[knots.rows] / np.where(total > 0, total, 1.0)
    components[knots.rows] = np.where(total > 0, scaled, [1.0, 0.0])
    main = replace(
        scene,
        component_fractions=components,
        parent=np.arange(n),
        fraction_of_parent=fraction,
        spot=np.full(n, -1),
        spots=spots,
    )
    rows = [main, _knot_rows(main, knots)]
    if tiles:
        made = _tile_rows(main, tiles, len(knots.rows), psf)
        first = np.array([tile.first for tile in tiles])
        rows[0] = _replaced(main, made.take(np.flatnonzero(first)))
        rows.append(made.take(np.flatnonzero(~first)))
    whole = _joined(rows)
    assert whole.fraction_of_parent is not None  # from here on
    return replace(whole, electrons=whole.fraction_of_parent[:, None] * scene.electrons[whole.parent])


def _replaced(main: Scene, made: Scene) -> Scene:
    """Return the Scene `main` with the rows of `made` in place of those of their objects."""
    columns: dict[str, Any] = {
        name: values.copy() for name, values in vars(main).items() if isinstance(values, np.ndarray)
    }
    for name, values in columns.items():
        values[made.parent] = getattr(made, name)
    return replace(main, **columns)


def part_keys(keys: IntArray, scene: Scene) -> IntArray:
    """Return the keys of a Scene's rows from those of its objects: parts have others."""
    if scene.parent is None or len(scene) == len(keys):
        return keys
    parent = scene.parent[len(keys) :]
    return np.concatenate([keys, _other_keys(keys, parent)])


@numba.njit(cache=True)
def _other_keys(keys: IntArray, parent: IntArray) -> IntArray:
    """Return a key for each of the parts, from its object's and the number of the object's parts before it."""
    before = np.zeros(len(keys), np.uint64)
    out = np.empty(len(parent), np.uint64)
    for i in range(len(parent)):
        p = parent[i]
        out[i] = word(~keys[p], _PART + before[p])
        before[p] += np.uint64(1)
    return out


def _knot_rows(main: Scene, knots: Knots) -> Scene:
    """Return the rows of objects' knots."""
    made = main.take(knots.rows)
    made.component_fractions[:] = 1.0, 0.0
    made.sersic[:] = 0.0
    made.sersic[:, 0, 2] = knots.size  # for the pixels that they cover
    return replace(made, fraction_of_parent=knots.fraction, spot=np.arange(len(knots.rows)))


class _Cut(NamedTuple):
    """A tile of an image.

    * group: number among the groups of images
    * fraction: of the image's flux
    * middle: (2,) column, row [px of the image] from the middle of the image
    * coefficients: (rows, columns), of sum 1
    """

    group: int
    fraction: float
    middle: FloatArray
    coefficients: FloatArray


class _Tile(NamedTuple):
    """A tile of an object's image.

    * row: of the object
    * fraction: of the object's flux
    * group: of spots, among those of images
    * at: (2,) position from the object [px]
    * matrix: (2, 2), pixel of the chip per pixel of the image
    * size: half-light radius [px of the image]
    * first: whether it is the first tile of its object
    """

    row: int
    fraction: float
    group: int
    at: FloatArray
    matrix: FloatArray
    size: float
    first: bool


def _tiles(
    objects: ObjectTable, rows: IntArray, lens: Callable[[IntArray], FloatArray]
) -> tuple[list[FloatArray], list[_Tile]]:
    """Return (images, tiles): coefficients of all tiles of images, and the _Tiles of the objects `rows`."""
    if not len(rows):
        return [], []
    names = objects["image_file"][rows]
    none = np.zeros(len(objects))
    scales = objects.get("image_scale", none)[rows]
    angles = objects.get("image_pa", none)[rows]
    skies = [sky_of(read_image(name), scale, angle) for name, scale, angle in zip(names, scales, angles, strict=True)]
    matrices = lens(rows) @ np.array(skies)
    steps = np.linalg.norm(matrices, axis=1)  # px per column, per row
    images: list[FloatArray] = []
    cut = {}
    tiles = []
    for name in dict.fromkeys(names.tolist()):
        picture = read_image(name)
        largest = steps[names == name].max(axis=0)
        cut[name] = list(_cut(image_coefficients(picture.pixels), largest, len(images)))
        images += [part.coefficients for part in cut[name]]
    for row, name, matrix in zip(rows, names.tolist(), matrices, strict=True):
        for i, part in enumerate(cut[name]):
            size = read_image(name).half_light if len(cut[name]) == 1 else 0.35 * min(part.coefficients.shape)
            tiles.append(_Tile(row, part.fraction, part.group, matrix @ part.middle, matrix, size, i == 0))
    return images, tiles


def _cut(coefficients: FloatArray, steps: FloatArray, first: int) -> Iterator[_Cut]:
    """Yield the tiles of an image that have flux; steps: pixels of the chip to a column, to a row; first: group."""
    rows, columns = coefficients.shape
    step_x, step_y = steps
    edges_y = _edges(rows, step_y)
    edges_x = _edges(columns, step_x)
    for y0, y1 in itertools.pairwise(edges_y):
        for x0, x1 in itertools.pairwise(edges_x):
            tile = coefficients[y0:y1, x0:x1]
            light = tile.sum()
            if light > 0:
                middle = np.array([x0 + x1, y0 + y1]) / 2 - np.array([columns, rows]) / 2
                yield _Cut(first, light, middle, tile / light)
                first += 1


def _edges(count: int, step: float) -> IntArray:
    """Return the edges of tiles along an axis of `count` pixels, each `step` pixels of the chip."""
    tiles = max(int(np.ceil(count * step / TILE_PX)), 1)
    return np.linspace(0, count, tiles + 1).round().astype(int)


def _tile_rows(main: Scene, tiles: list[_Tile], first: int, psf: PsfSet) -> Scene:
    """Return the Scene of tiles; first: the group of the first image."""
    assert main.spots is not None
    made = main.take(np.array([tile.row for tile in tiles]))
    made.component_fractions[:] = (1.0, 0.0)
    made.sersic[:] = 0.0
    made.sersic[:, 0, 2] = [tile.size for tile in tiles]
    at = np.array([tile.at for tile in tiles])
    matrix = np.array([tile.matrix for tile in tiles])
    x = made.x + at[:, 0]
    y = made.y + at[:, 1]
    node, weight, outside = psf.weights(x, y)
    spot = first + np.array([tile.group for tile in tiles])
    return replace(
        made,
        x=x,
        y=y,
        matrix=matrix,
        node=node.astype(np.int64),
        weight=weight,
        outside=outside,
        fraction_of_parent=np.array([tile.fraction for tile in tiles]),
        spot=spot,
        reach=None if made.reach is None else _reach_of(made.reach, at, main.spots.extent[spot], matrix),
    )


def _reach_of(reach: AnyArray, at: FloatArray, extent: FloatArray, matrix: FloatArray) -> AnyArray:
    """Return the reach (n,) of tiles: their own extent, and what the objects' reach had in addition to all tiles."""
    extent = extent * np.linalg.norm(matrix, ord=2, axis=(1, 2))
    farthest = np.hypot(*at.T) + extent
    blur = np.where(reach > farthest, reach - farthest, POINT_MAX)  # below: the object's reach was cut off
    return np.minimum(reach, np.ceil(extent + np.clip(blur, POINT_MIN, POINT_MAX))).astype(reach.dtype)


def _joined(scenes: list[Scene]) -> Scene:
    """Return the rows of several Scenes of the same spots."""
    one = vars(scenes[0])
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(scene, name) for scene in scenes])
        for name, values in one.items()
        if name != "spots" and values is not None
    }
    return replace(scenes[0], **columns)
