"""The light of objects too faint to be rendered one by one: spread smoothly, without loss.

An object's electrons are distributed bilinearly over the four nearest points of a mesh of MESH pixels, and the mesh is
interpolated bilinearly on the window, so an object becomes a pyramid two meshes wide around its position. Its light and
first moments are conserved, and so is all structure larger than the mesh.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.render.canvas import Canvas
    from csstsim.render.scene import Scene

MESH = 64


def add_unresolved(canvas: Canvas, scene: Scene) -> tuple[FloatArray, IntArray]:
    """Add the light of a Scene as expected electrons; return ((n,) electrons on the window, (n, 4) boxes)."""
    assert canvas.expected is not None  # None: for photons alone
    window = canvas.window
    response = canvas.response_array
    electrons = scene.electrons.sum(axis=1)
    # Mesh point k is at pixel (k - 1) MESH of the window; objects beyond the outermost points add no light
    u = (scene.x - window.x0) / MESH + 1
    v = (scene.y - window.y0) / MESH + 1
    shape = window.ny // MESH + 4, window.nx // MESH + 4
    mesh = np.zeros(shape)
    on_window = np.zeros(len(scene))
    level = np.zeros(shape)  # light that a mesh point of value 1 puts on the window
    _scatter(mesh, u, v, electrons / MESH**2)
    _spread(canvas.expected, mesh, response)
    _collect(level, response)
    _gather(on_window, level, u, v, electrons / MESH**2)
    box = np.column_stack([*_pyramid(u, window.nx), *_pyramid(v, window.ny)])
    return on_window, box + canvas.corner


def _pyramid(u: FloatArray, pixels: int) -> tuple[IntArray, IntArray]:
    """Return the first and last pixel (half-open) of the pyramids at mesh positions u, along an axis of `pixels`."""
    column = np.floor(u).astype(int) - 1
    return np.clip((column - 1) * MESH, 0, pixels), np.clip((column + 2) * MESH, 0, pixels)


@numba.njit(cache=True)
def _scatter(mesh: FloatArray, u: FloatArray, v: FloatArray, light: FloatArray) -> None:
    for i in range(len(u)):
        column = int(np.floor(u[i]))
        row = int(np.floor(v[i]))
        if 0 <= column < mesh.shape[1] - 1 and 0 <= row < mesh.shape[0] - 1:
            a = u[i] - column
            b = v[i] - row
            mesh[row, column] += (1 - a) * (1 - b) * light[i]
            mesh[row, column + 1] += a * (1 - b) * light[i]
            mesh[row + 1, column] += (1 - a) * b * light[i]
            mesh[row + 1, column + 1] += a * b * light[i]


@numba.njit(cache=True)
def _gather(out: FloatArray, mesh: FloatArray, u: FloatArray, v: FloatArray, light: FloatArray) -> None:
    for i in range(len(u)):
        column = int(np.floor(u[i]))
        row = int(np.floor(v[i]))
        if 0 <= column < mesh.shape[1] - 1 and 0 <= row < mesh.shape[0] - 1:
            a = u[i] - column
            b = v[i] - row
            near = (1 - a) * mesh[row, column] + a * mesh[row, column + 1]
            far = (1 - a) * mesh[row + 1, column] + a * mesh[row + 1, column + 1]
            out[i] = ((1 - b) * near + b * far) * light[i]


@numba.njit(cache=True)
def _spread(image: FloatArray, mesh: FloatArray, response: FloatArray) -> None:
    for y in range(image.shape[0]):
        row = y // MESH + 1
        b = (y % MESH) / MESH
        for x in range(image.shape[1]):
            column = x // MESH + 1
            a = (x % MESH) / MESH
            near = (1 - a) * mesh[row, column] + a * mesh[row, column + 1]
            far = (1 - a) * mesh[row + 1, column] + a * mesh[row + 1, column + 1]
            image[y, x] += ((1 - b) * near + b * far) * response[y, x]


@numba.njit(cache=True)
def _collect(level: FloatArray, response: FloatArray) -> None:
    for y in range(response.shape[0]):
        row = y // MESH + 1
        b = (y % MESH) / MESH
        for x in range(response.shape[1]):
            column = x // MESH + 1
            a = (x % MESH) / MESH
            level[row, column] += (1 - a) * (1 - b) * response[y, x]
            level[row, column + 1] += a * (1 - b) * response[y, x]
            level[row + 1, column] += (1 - a) * b * response[y, x]
            level[row + 1, column + 1] += a * b * response[y, x]
