"""The family of profiles of a frame's galaxies: rendered skies of either, frames of few galaxies, and sums by hand."""

import numpy as np
import pytest
from measure.galaxy_images import PIXEL, RMS, SIDE, rendered, sources_of_rows

from csstsim.base.rng import stream
from csstsim.measure.light import family
from csstsim.measure.light.family import likelier_family
from csstsim.measure.light.profile_tables import BULGES, FAMILIES, SERSIC, profile_tables

FLUX = 4e4  # electron


@pytest.fixture(scope="module")
def families(fabricate):
    return profile_tables(fabricate.psf, (0, 0), (SIDE, SIDE), PIXEL, FAMILIES)


def sky(fabricate, galaxies, flux=FLUX):
    """Return the arguments of `total_light` for galaxies (index, size [px], fraction of the bulge) in a row."""
    rng = stream(len(galaxies), "galaxies")
    images = [flux * rendered(fabricate, n, size, dx=0, dy=0, bulge=bulge) for n, size, bulge in galaxies]
    image = np.concatenate(images, axis=1)
    image += rng.normal(0.0, np.sqrt(RMS**2 + np.maximum(image, 0.0)))
    rows = [(SIDE // 2 + k * SIDE, SIDE // 2, 0.8, 1.0, size) for k, (_, size, _) in enumerate(galaxies)]
    return sources_of_rows(image, rows, np.full(image.shape, RMS))


@pytest.mark.parametrize(
    ("galaxies", "wanted"),
    [
        ([(index, size, 0.0) for index in (1.6, 1.8, 2.0, 2.4) for size in (4.0, 6.0, 9.0)], SERSIC),
        ([(1.0, size, bulge) for bulge in (0.15, 0.3, 0.5) for size in (4.0, 6.0, 9.0)], BULGES),
        ([(1.0, size, 0.0) for size in np.linspace(2.0, 8.0, 16)], BULGES),  # of both
        ([(2.0, 8.0, 0.0)] * 2, BULGES),  # too few
    ],
)
def test_a_sky_has_the_family_of_its_galaxies(fabricate, families, galaxies, wanted):
    assert likelier_family(*sky(fabricate, galaxies), families).family == wanted


def test_a_frame_without_sources_has_the_first(families):
    empty = np.full((SIDE, SIDE), 0.0)
    none = sources_of_rows(empty, np.zeros((0, 5)), empty + RMS)
    assert likelier_family(*none, families) is families[0]


def test_kinds_of_both_families_are_as_frequent_in_both():
    """Otherwise, a sky of discs would choose by the assumed fractions, not by its pixels."""
    in_bulges, in_sersic = ({kind: fraction / sum(family.fractions) for kind, fraction in
                             zip(family.kinds, family.fractions, strict=True)} for family in FAMILIES)  # fmt: skip
    same = {(index, 4.0, 0.0): (index, 4.0, 0.0) for index in (0.5, 0.7, 1.0)}
    same |= {(1.0, index, 1.0): (index, 4.0, 0.0) for index in (4.0, 6.0)}  # a bulge alone
    for one, other in same.items():
        assert in_bulges[one] == pytest.approx(in_sersic[other], rel=0.02)


@pytest.mark.parametrize(
    ("gains", "points", "wanted"),
    [
        ([1.0] * 12, [0.0] * 12, 1),
        ([1.0] * 9, [0.0] * 9, 0),  # 9 is not enough
        ([1e5] * 3, [0.0] * 3, 0),  # each counts 3
        ([1e5] * 9, [0.0] * 9, 0),  # 27 +- 9
        ([1e5] * 10, [0.0] * 10, 1),
        ([3.0, -2.0] * 24, [0.0] * 48, 0),  # 24 +- 18
        ([3.0, -1.0] * 24, [0.0] * 48, 1),  # 48 +- 15
        ([1.0] * 12 + [-1e5] * 3, [0.0] * 15, 0),
        ([1.0] * 12 + [-1e5] * 3, [0.0] * 12 + [0.2] * 3, 1),  # points do not count
        ([1.0] * 12 + [np.nan], [0.0] * 12 + [np.nan], 1),
        ([1.0] * 12 + [np.nan], [0.0] * 13, 1),
    ],
)
def test_each_galaxy_counts_little(monkeypatch, gains, points, wanted):
    def fit(found, table, unusable, counted, tables):
        return {"evidence": 700.0 + tables * np.array(gains), "point": np.array(points)}

    monkeypatch.setattr(family, "total_light", fit)
    assert likelier_family(None, None, None, None, (0, 1)) == wanted
