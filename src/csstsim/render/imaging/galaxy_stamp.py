"""A galaxy's stamp: one convolution with the mixture of the PSF's nodes and sub-bands.

Disk and bulge are Sersic profiles under one 2 x 2 matrix. Each is split (profiles.sersic). The transform of the inner
part is multiplied by that of the PSF (render.psf_mixture) at the frequencies of a small periodic image, folded onto the
frequencies of the pixels (the aliasing of sampling), and transformed back. The outer part is so smooth that the PSF
hardly changes it; it is added in real space. So no transform is larger than 1280 pixels and no wing wraps round.

`plan_galaxies` chooses the radius of the split. Left out: the blurring of the outer part by the PSF, whose only effect
on it is to remove the light outside the box (size of the error: benchmarks/stamps.py). A galaxy so long and thin that
its outer part begins where the PSF changes it is blurred across its long axis (render.imaging.thin_galaxy).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numba
import numpy as np
import scipy.fft

from csstsim.base.types import BoolArray, ComplexArray, FloatArray, IntArray
from csstsim.catalog.profiles.log_table import first_of, nodes, read
from csstsim.catalog.profiles.sersic import CUT_NONE, K2_HIGH, K2_LOW, R2_HIGH, R2_LOW, cut_for, extent, tables
from csstsim.render.imaging.thin_galaxy import Across, Components, across, add_band
from csstsim.render.psf_mixture import BINS, transform

if TYPE_CHECKING:
    from csstsim.render.canvas import Box
    from csstsim.render.imaging.stamper import Stamper
    from csstsim.render.scene import Scene

_WORST = 3e-4  # of the peak: the largest change by blurring in the outer part ...
_BLURRED = 3e-3  # of the peak: a larger change is not left out
_LOCAL = 0.05  # ... where the change is more than this fraction of the local value
_CORE2 = 1.5  # px^2: half the variance of the PSF's core and the pixel
_WINGS2 = 6.5  # px^2: the same of the box, with the curvature of the split (measured: benchmarks/stamps.py)
_RHO = np.geomspace(0.02, 200.0, 48)  # r_e
_START_PX = 14.0  # smallest radius at which the outer part begins
_ROWS = 64
_EXTENT_MAX = 448.0  # px: half the side of the inner part
_TAIL = 3e-4  # of the peak: largest sum of the frequencies left out
SIZE_MIN = 1e-5  # arcsec, half-light radius: a smaller galaxy is a point
_ANGLES = np.arange(8) * np.pi / 16  # from a galaxy's short axis
_K2_FIRST = first_of(K2_LOW)
_R2_FIRST = first_of(R2_LOW)
_NONE = np.zeros(len(nodes(K2_LOW, K2_HIGH))), np.zeros(len(nodes(R2_LOW, R2_HIGH)))
_ONES = np.ones((2, len(_NONE[0])))
_SIZES = np.array([*range(48, 128, 16), *range(128, 256, 32), *range(256, 512, 64), *range(512, 1281, 128)])


@dataclass(frozen=True)
class Plan:
    """How n galaxies are split and how large their transforms are."""

    cut: FloatArray  # (n, 2) r_e of each component; inf: no outer part
    half: IntArray  # (n,) px, half the side of the square on which the inner part is computed
    size: IntArray  # (n,) px, period of the transform
    thin: BoolArray  # (n,) bool: so long and thin that the PSF changes the outer part, which is blurred

    def take(self, rows: IntArray) -> Plan:
        """Return the plan of the galaxies at the rows of an index array, in that order."""
        return Plan(**{name: values[rows] for name, values in vars(self).items()})


def plan_galaxies(scene: Scene, reach: IntArray, box: float, rows: BoolArray) -> Plan:
    """Return the Plan of a Scene whose objects `rows` (n,) bool are galaxies.

    reach: (n,) px, half sides of the stamps; box: half the side of the PSF's box [px]. The outer part is not blurred.
    It begins where that changes the image by less than _WORST of the peak, and not within 14 px. Two errors are
    estimated. The PSF's core blurs by its variance times the curvature of the profile, largest across the long axis:
    there exp(-b rho^(1/n)) has the relative curvature b / n rho^(1/n - 2) over the squared short half-light radius.
    The PSF's wings blur by the curvature of the split itself.
    """
    present = (scene.component_fractions > 0) & rows[:, None] & (scene.sersic[:, :, 0] > 0)
    index, b, size = np.moveaxis(np.where(present[..., None], scene.sersic, 1.0), -1, 0)
    size = np.maximum(size, SIZE_MIN)
    wide = np.hypot(scene.matrix[:, :, 0], scene.matrix[:, :, 1]).max(axis=1)[:, None] * size  # px
    axes = np.linalg.svd(scene.matrix, compute_uv=False)[:, None, :] * size[:, :, None]
    short = axes[..., 1, None]
    centre = np.minimum(1.0 / np.sqrt(axes.prod(axis=-1)), 1.0)
    index_at = index[..., None]  # of each radius of _RHO
    b_at = b[..., None]
    with np.errstate(under="ignore"):
        level = np.exp(b_at * (centre[..., None] ** (1 / index_at) - _RHO ** (1 / index_at)))
    core = b_at / index_at * _RHO ** (1 / index_at - 2) * _CORE2 / short**2
    wrong = np.maximum(np.minimum(core * level, core * _WORST / _LOCAL), _WINGS2 / (_RHO * short) ** 2 * level)
    short = short[..., 0]
    start = _RHO[np.minimum((wrong > _WORST).sum(axis=-1), len(_RHO) - 1)]
    radius = 2 * np.maximum(start, _START_PX / wide)
    longest = np.minimum(2 * reach[:, None], _EXTENT_MAX) / wide
    # Too long for a transform: the better of a split too near the centre and no transform at all; or blur the outer
    capped = (radius > longest) & (2 * reach[:, None] > _EXTENT_MAX)
    last = np.maximum((0.5 * longest[..., None] > _RHO).sum(axis=-1) - 1, 0)
    near = np.take_along_axis(wrong, last[..., None], axis=-1)[..., 0]
    bare = b / index * short ** (-1 / index) * _CORE2  # the curvature one pixel from the centre
    thin = (capped & present & (np.minimum(near, bare) > _BLURRED)).any(axis=1)
    radius = np.where(capped & (bare < near) & ~thin[:, None], CUT_NONE, np.minimum(radius, longest))
    cut = np.full(index.shape, np.inf)
    ends = np.zeros(index.shape)
    for i, c in np.argwhere(present).tolist():
        cut[i, c] = cut_for(index[i, c], radius[i, c])
        ends[i, c] = extent(index[i, c]) if cut[i, c] > CUT_NONE else 0.0
    end = (np.minimum(cut, ends) * wide).max(axis=1, where=present, initial=0.0)
    if scene.spots is not None and scene.spot is not None:
        grown = np.linalg.norm(scene.matrix, ord=2, axis=(1, 2))
        end = np.where(scene.spot >= 0, grown * scene.spots.extent[scene.spot], end)
    half = np.minimum(reach, np.ceil(end + box)).astype(int)
    wanted = np.maximum(half + np.maximum(box, end + box / 4) + 1, 2 * half + 2)
    sizes = _SIZES[np.minimum(np.searchsorted(_SIZES, wanted), len(_SIZES) - 1)]
    return Plan(cut, half, np.where(rows, sizes, 0), thin)


def galaxy_stamp(
    stamper: Stamper, i: int, node_electrons: FloatArray, bounds: Box | None, many: bool = False
) -> tuple[FloatArray, float]:
    """Return (stamp, light) of a Stamper's galaxy i, as Stamper.stamp.

    many: whether many galaxies share size and nodes, so that keeping the nodes' transforms saves time. The stamp may
    be negative by the amount of the approximations.
    """
    mixer = stamper.mixer
    scene = stamper.scene
    plan = stamper.plan
    reach = stamper.reach[i]
    core = stamper.core
    node = scene.node[i]
    x = scene.x[i]
    y = scene.y[i]
    half = plan.half[i]
    size = int(plan.size[i])
    spots = -1 if scene.spot is None else scene.spot[i]
    components = _components(scene, plan, i)
    if spots >= 0:  # their transform is part of the mixture: what the components' tables multiply is 1
        components = components._replace(inner=_ONES)
    frequency = BINS[-1] if plan.thin[i] else _cutoff(components, mixer.envelope(node, node_electrons))
    last = min(int(frequency * size) + 1, size)
    x0, x1, y0, y1 = (0, 0, 0, 0) if bounds is None else bounds
    stamp = np.zeros((y1 - y0, x1 - x0))
    first_x = round(x) - half
    first_y = round(y) - half
    if many:
        mixture = mixer.mixed_transforms(node, node_electrons, size, last, core is not None)
    else:
        cells = mixer.mixed_cells(node, node_electrons)
        mixture = transform(cells if core is None else cells * core, size, mixer.per_pixel, last)
    blurred = across(mixture, size, components, 1.5 * reach + 1, mixer.half) if plan.thin[i] else None
    if spots >= 0 and scene.spots is not None:
        mixture *= scene.spots.transform(spots, components.matrix, size, last)
    folded = _convolved(mixture, components, x - first_x, y - first_y, size)
    image = scipy.fft.irfft2(folded, s=(size, size), overwrite_x=True)[: 2 * half + 1, : 2 * half + 1]
    whole = image.sum(dtype=np.float64)
    low_x = max(x0, first_x)
    high_x = min(x1, first_x + 2 * half + 1)
    low_y = max(y0, first_y)
    high_y = min(y1, first_y + 2 * half + 1)
    if low_x < high_x and low_y < high_y:
        stamp[low_y - y0 : high_y - y0, low_x - x0 : high_x - x0] = image[
            low_y - first_y : high_y - first_y, low_x - first_x : high_x - first_x
        ]
    if np.isfinite(components.cut).any():
        electrons = mixer.light(node, node_electrons, core is not None)
        before = stamp.sum()
        _add_smooth(stamp, components, blurred, x - x0, y - y0, electrons)
        if stamp.shape == (2 * reach + 1, 2 * reach + 1):
            whole += stamp.sum() - before
        else:
            corner_x = x - round(x) + reach
            corner_y = y - round(y) + reach
            whole += _outer_light(components, blurred, corner_x, corner_y, 2 * reach + 1, electrons)
    return stamp, whole


def _components(scene: Scene, plan: Plan, i: int) -> Components:
    """Return the Components of galaxy i."""
    light = scene.component_fractions[i]
    sersic = scene.sersic[i]
    cut = plan.cut[i]
    disk, bulge = sersic[:, 0] * (light > 0)
    disk_cut, bulge_cut = cut
    inner, outer = _component_tables(disk, disk_cut, bulge, bulge_cut)
    return Components(sersic, light, scene.matrix[i], inner, outer, cut)


def _outer_light(
    components: Components, blurred: Across | None, x: float, y: float, side: int, electrons: float
) -> float:
    """Return the light of the outer parts on a square of `side` px, computed in strips of _ROWS rows."""
    total = 0.0
    for row in range(0, side, _ROWS):
        strip = np.zeros((min(_ROWS, side - row), side))
        _add_smooth(strip, components, blurred, x, y - row, electrons)
        total += strip.sum()
    return total


def _add_smooth(
    stamp: FloatArray, components: Components, blurred: Across | None, x: float, y: float, electrons: float
) -> None:
    """Add the outer parts to `stamp`, as they are or, within the band of an Across, blurred."""
    side, band = (np.zeros(2), 0.0) if blurred is None else (blurred.axes[:, 1].copy(), blurred.band)
    _add_outer(stamp, components, side, band, x, y, electrons)
    if blurred is not None:
        add_band(stamp, blurred.values, blurred.axes, blurred.band, x, y)


@lru_cache(256)
def _component_tables(disk: float, disk_cut: float, bulge: float, bulge_cut: float) -> tuple[FloatArray, FloatArray]:
    """Return (inner (2, m), outer (2, l)): tables of profiles.sersic for disk and bulge; zeros for index 0."""
    both = [tables(*key) if key[0] > 0 else _NONE for key in ((disk, disk_cut), (bulge, bulge_cut))]
    inner, outer = (np.stack(parts) for parts in zip(*both, strict=True))
    return inner, outer


@numba.njit(cache=True)
def _cutoff(components: Components, envelope: FloatArray) -> float:
    """Return the frequency [cycles per pixel] above which the sum of all amplitudes is below _TAIL of the peak.

    envelope: the PSF's transform at BINS, of flux 1.
    """
    matrix = components.matrix
    light = components.light
    p = matrix[0, 0] ** 2 + matrix[1, 0] ** 2
    q = matrix[0, 1] ** 2 + matrix[1, 1] ** 2
    r = matrix[0, 0] * matrix[0, 1] + matrix[1, 0] * matrix[1, 1]
    middle = 0.5 * (p + q)
    spread = np.sqrt(0.25 * (p - q) ** 2 + r * r)
    power = np.zeros(len(BINS))  # amplitude per bin of log frequency, an upper bound
    line = np.empty(1)
    bits = line.view(np.int64)
    for j in range(len(BINS)):
        for angle in _ANGLES:
            k2 = (2 * np.pi * BINS[j]) ** 2 * max(middle - spread * np.cos(2 * angle), 0.0)
            for c in range(2):
                if light[c] > 0:
                    line[0] = k2 * components.sersic[c, 2] ** 2
                    power[j] += light[c] * abs(read(components.inner[c], _K2_FIRST, bits[0]))
        power[j] *= envelope[j] * BINS[j] ** 2
    left = _TAIL * power.sum()
    j = len(BINS) - 1
    while j > 0 and left >= power[j]:
        left -= power[j]
        j -= 1
    return BINS[min(j + 1, len(BINS) - 1)]


@numba.njit(cache=True)
def _convolved(mixture: ComplexArray, components: Components, x: float, y: float, size: int) -> ComplexArray:
    """Return the folded transform, (size, size // 2 + 1) complex64, of the inner part at x, y from the first pixel.

    mixture: the PSF's, of psf_mixture.transform.
    """
    matrix = components.matrix
    light = components.light
    last = mixture.shape[1] - 1
    half = size // 2
    step = 2 * np.pi / size
    out = np.zeros((size, half + 1), np.complex64)
    turn_x = np.exp(-1j * step * x * np.arange(last + 1)).astype(np.complex64)
    turn_y = np.exp(-1j * step * y * np.arange(-last, last + 1)).astype(np.complex64)
    m00 = step * matrix[0, 0]
    m01 = step * matrix[0, 1]
    m10 = step * matrix[1, 0]
    m11 = step * matrix[1, 1]
    line = np.empty(last + 1)
    value = np.empty(last + 1, np.float32)
    term = np.empty(last + 1, np.complex64)
    bits = line.view(np.int64)
    for row in range(2 * last + 1):
        j_y = row - last
        count = int(np.sqrt(last * last - j_y * j_y)) + 1
        value[:] = 0.0
        for c in range(2):
            if light[c] > 0:
                r_e = components.sersic[c, 2]
                part = light[c]
                table = components.inner[c]
                a = m00 * r_e
                p = m10 * j_y * r_e
                b = m01 * r_e
                q = m11 * j_y * r_e
                for column in range(count):
                    line[column] = (a * column + p) ** 2 + (b * column + q) ** 2
                for column in range(count):
                    value[column] += part * read(table, _K2_FIRST, bits[column])
        turn = turn_y[row]
        for column in range(count):
            term[column] = mixture[row, column] * (turn * turn_x[column]) * value[column]
        # Each term also gives, conjugated, the opposite frequency; only columns up to half the period are kept
        row_out = out[j_y % size]
        back = out[-j_y % size]
        for column in range(min(count, half + 1)):
            row_out[column] += term[column]
        for column in range(half, min(count, size + 1)):
            back[size - column] += np.conj(term[column])
        for column in range(size, count):
            row_out[column - size] += term[column]
    return out


@numba.njit(cache=True)
def _add_outer(
    stamp: FloatArray,
    components: Components,
    side: FloatArray,
    band: float,
    x: float,
    y: float,
    electrons: float,
) -> None:
    """Add the outer parts to `stamp` (float64), the galaxy's centre at x, y from its first pixel.

    side: unit vector across the long axis; pixels within `band` [px] of that axis are left out.
    """
    matrix = components.matrix
    light = components.light
    cut = components.cut
    determinant = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    line = np.empty(stamp.shape[1])
    bits = line.view(np.int64)
    for c in range(2):
        if not (light[c] > 0 and np.isfinite(cut[c])):
            continue
        r_e = components.sersic[c, 2]
        inside = (0.5 * cut[c]) ** 2 if cut[c] > CUT_NONE else -1.0
        level = electrons * light[c] / (r_e * r_e * abs(determinant))
        a = matrix[1, 1] / (determinant * r_e)
        b = -matrix[0, 1] / (determinant * r_e)
        d = -matrix[1, 0] / (determinant * r_e)
        e = matrix[0, 0] / (determinant * r_e)
        for row in range(stamp.shape[0]):
            dy = row - y
            for column in range(stamp.shape[1]):
                dx = column - x
                u = a * dx + b * dy
                v = d * dx + e * dy
                line[column] = u * u + v * v
            if band > 0:
                for column in range(stamp.shape[1]):
                    if -band <= side[0] * (column - x) + side[1] * dy < band:
                        line[column] = -2.0  # below any `inside`
            for column in range(stamp.shape[1]):
                if line[column] > inside:
                    stamp[row, column] += level * read(components.outer[c], _R2_FIRST, bits[column])
