"""Parts of the extraction against scipy and plain numpy: the collapsed PSF, the sky in strips, columns near others."""

import numpy as np
import pytest

from csstsim.measure.spectra import line_profile, local_sky, spectrum_trust
from csstsim.measure.spectra.line_profile import OFFSETS
from csstsim.measure.spectra.spectrum_columns import BESIDE, LOST, SATURATED, UNEVEN


@pytest.mark.parametrize(("n", "per_pixel"), [(256, 2), (16, 4)])
def test_spline_of_a_collapsed_psf_is_scipys(n, per_pixel):
    from scipy.interpolate import CubicSpline

    half, values = n / 2 / per_pixel, np.random.default_rng(1).random((4, n + 1))
    edges = np.arange(n + 1) / per_pixel - half
    wanted = CubicSpline(edges, values, axis=1, bc_type="natural")(np.clip(OFFSETS, -half, half))
    np.testing.assert_allclose(values @ line_profile._spline(n, per_pixel), wanted, rtol=0, atol=1e-12)


def plain_sky(data, good, offset, fraction, inner, width):
    """(3, blocks): the module's words with numpy, strip by strip."""
    out = []
    for part in np.array_split(np.arange(len(data)), max(1, round(len(data) / local_sky.BLOCK))):
        sides = []
        for side in (-1, 1):
            strip = good[part] & (side * offset[part] >= inner) & (side * offset[part] < inner + width)
            values, own = data[part][strip], fraction[part][strip]
            if len(values) < max(local_sky.USABLE * len(part) * width, 2):
                continue
            kept = np.ones(len(values), bool)
            for _ in range(local_sky.ROUNDS):
                middle = np.median(values[kept])
                spread = 1.4826 * np.median(np.abs(values[kept] - middle)) + 0.5
                kept = np.abs(values - middle) <= local_sky.CLIP * spread
            sides.append((values[kept].mean(), values[kept].var() / kept.sum(), own[kept].mean()))
        found = np.mean(sides, axis=0) if sides else np.full(3, np.nan)
        out.append(found / (1, max(len(sides), 1), 1))
    return np.transpose(out)


@pytest.mark.parametrize("columns", [1, 48, 300])
@pytest.mark.parametrize("case", ["plain", "rays", "one side", "none"])
def test_sky_of_strips_against_plain_numpy(columns, case):
    rng = np.random.default_rng(columns)
    centre = rng.uniform(-0.5, 0.5, columns)
    offset = np.arange(-30, 31) - centre[:, None]
    data, fraction = rng.normal(20.0, 6.0, offset.shape), rng.random(offset.shape) / 50
    good = rng.random(offset.shape) > 0.05
    if case == "rays":
        data[rng.random(offset.shape) < 0.03] += 3000.0
    elif case == "one side":
        good[:, 31:] = False
    elif case == "none":
        good[:] = False
    strips, wanted = (
        local_sky.Strips.of(data, good, offset, fraction, 8.0, 16.0),
        plain_sky(data, good, offset, fraction, 8.0, 16.0),
    )
    found = strips.by_block(np.zeros(columns))
    np.testing.assert_allclose(found, wanted, rtol=1e-10)
    assert np.isnan(found.level).all() == (case == "none")
    light = rng.random(columns)
    lit = local_sky.Strips.of(data + light[:, None] * fraction, good, offset, fraction, 8.0, 16.0)
    np.testing.assert_allclose(lit.by_block(light), wanted, rtol=1e-10)
    sky = strips.sky(np.zeros(columns))
    assert len(sky.level) == columns and np.isnan(sky.level).all() == (case == "none")


def plain_fractions(profile, band, fraction, offset):
    position = [OFFSETS, OFFSETS]
    below = [[(1 - t) * np.interp(o + d, position[0], profile[b]) + t * np.interp(o + d, position[1], profile[b + 1])
              for b, t, o in zip(band, fraction, offset, strict=True)] for d in (-0.5, 0.5)]  # fmt: skip
    return np.subtract(below[1], below[0])


def test_fractions_of_pixels_are_differences_of_the_profile():
    rng = np.random.default_rng(2)
    profile = np.cumsum(rng.random((4, len(OFFSETS))), axis=1)
    profile /= profile[:, -1:]
    band, fraction, offset = np.array([0, 1, 2]), np.array([0.0, 0.3, 1.0]), rng.uniform(-62.0, 62.0, (3, 50))
    found = line_profile.pixel_fractions(profile, band, fraction, offset)
    np.testing.assert_allclose(found, plain_fractions(profile, band, fraction, offset), rtol=0, atol=1e-12)


@pytest.mark.parametrize("marked", [[], [0], [9], [3, 4], list(range(10))])
@pytest.mark.parametrize("reach", [0, 1, 3, 20])
def test_columns_near_marked_ones(marked, reach):
    lit = np.isin(np.arange(10), marked)
    wanted = [any(abs(k - m) <= reach for m in marked) for k in range(10)]
    assert spectrum_trust._near(lit, reach).tolist() == wanted


@pytest.mark.parametrize("columns", [300, 411])
def test_a_sky_that_rises_along_the_columns_is_read_where_it_is(columns):
    """Without noise: the level in each column, between the middles of the outer blocks, is that of the column."""
    offset = np.arange(-40, 41.0) + np.zeros((columns, 1))
    level = 20.0 + 0.3 * np.arange(columns)
    data = np.broadcast_to(level[:, None], offset.shape).astype(np.float32)
    strips = local_sky.Strips.of(data, np.ones(offset.shape, bool), offset, np.zeros(offset.shape), 10, 20)
    found, inner = strips.sky(np.zeros(columns)).level, slice(local_sky.BLOCK, -local_sky.BLOCK)
    assert found[inner] == pytest.approx(level[inner], abs=0.02)


def spectrum(electrons, error=10.0, flags=0):
    n = len(electrons)
    return {
        "electrons": np.array(electrons, float),
        "electrons_err": np.full(n, error),
        "flags": flags + np.zeros(n, int),
    }


def test_columns_next_to_saturated_and_lost_ones_are_not_trusted():
    """3 columns from a saturated one; 63 from one that has no result; of a lost one alone, none."""
    n, along = 300, np.tile((OFFSETS >= 0).astype(float), (4, 1))
    flags = np.zeros(n, int)
    flags[20], flags[150], flags[290] = SATURATED, SATURATED | LOST, LOST
    bits = spectrum_trust.untrusted(spectrum(np.ones(n), flags=flags), along)
    beside = np.flatnonzero(bits & BESIDE)
    near = 63
    wanted = [*range(17, 20), *range(21, 24), *range(150 - near, 150), *range(151, 151 + near)]
    assert beside.tolist() == wanted and not (bits & UNEVEN).any()


def test_wings_of_a_bright_column_make_the_faint_ones_uneven():
    """A tenth of the light lies evenly 10 px about a column: 0.1 / 20 a column beyond the core of 3."""
    wing = np.clip(OFFSETS / 20 + 0.5, 0, 1)
    along = np.tile(0.9 * (OFFSETS >= 0) + 0.1 * wing, (4, 1))
    light = np.zeros(200)
    light[100] = 10_000.0
    for error, marked in ((24.9, True), (25.1, False)):  # half of 10,000 x 0.005
        bits = spectrum_trust.untrusted(spectrum(light, error), along)
        uneven = np.flatnonzero(bits & UNEVEN)
        beyond = [k for k in range(91, 110) if abs(k - 100) > spectrum_trust.CORE]
        assert set(uneven) - {100} == (set(beyond) if marked else set())
    even = spectrum_trust.untrusted(spectrum(np.full(200, 1e6), 1.0), along)
    assert not even.any()  # what a column loses it gets from others, and the ends go on
