"""Cosmic rays: the pixels they strike, their lengths and energies, diffusion, conservation, edges."""

import numpy as np
import pytest
from scipy import stats

from csstsim.base.rng import stream
from csstsim.detector.cosmic_ray import Tracks, boxes, deposit, draw_tracks

KEY = np.uint64(5)
CHIP = (9232, 9216)


@pytest.fixture(scope="module")
def rays(camera):
    return camera.detector.cosmic_rays


def tracks_of(x, y, dx, dy, electrons):
    values = (np.atleast_1d(np.asarray(a, float)) for a in (x, y, dx, dy))
    return Tracks(*values, np.atleast_1d(np.asarray(electrons, np.int64)))


def test_the_rate_gives_the_fraction_of_the_paper(rays, camera):
    """0.75 permille of the pixels before diffusion in 150 s with half of the readout: 8 chips, 3 sigma.

    The sigma is that of the chips' mean from their scatter. With 200 e- per pixel of its length a track leaves some
    in every pixel it crosses by more than 0.005 px.
    """
    seconds = 150 + camera.detector.readout_time / 2
    assert -np.log1p(-7.5e-4) / (1 + 4 * 12.5 / np.pi) / seconds == pytest.approx(rays.rate, rel=1e-4)
    struck = []
    for i in range(8):
        tracks = draw_tracks(CHIP, seconds, rays, stream(1, "rate", i))
        tracks = tracks._replace(electrons=(200 * np.hypot(tracks.dx, tracks.dy) + 1).astype(np.int64))
        struck.append(len(deposit(CHIP, tracks, 0.0, KEY).pixel) / (CHIP[0] * CHIP[1]))
    assert abs(np.mean(struck) - 7.5e-4) < 3 * np.std(struck, ddof=1) / np.sqrt(8)
    assert np.std(struck, ddof=1) < 0.05 * 7.5e-4


def test_lengths_energies_and_directions(rays):
    """A million tracks against the paper's distributions: KS, p > 1e-4; the share of long ones to 5 sigma."""
    tracks = draw_tracks(CHIP, 4e4, rays, stream(2, "shapes"))
    n, length = len(tracks.x), np.hypot(tracks.dx, tracks.dy)
    assert n > 9e5
    long = length > 20
    assert abs(long.mean() - 0.05) < 5 * np.sqrt(0.05 * 0.95 / n)
    assert stats.kstest(length[~long], "uniform", (0, 20)).pvalue > 1e-4
    assert stats.kstest(length[long], "uniform", (20, 80)).pvalue > 1e-4
    energy = np.log10(tracks.electrons)
    sigma = 0.6 / np.sqrt(8 * np.log(2))
    assert abs(energy.mean() - 3.3) < 5 * sigma / np.sqrt(n) + 1e-4  # whole electrons
    assert abs(energy.std() / sigma - 1) < 5 / np.sqrt(2 * n)
    angle = np.arctan2(tracks.dy, tracks.dx)
    assert stats.kstest(angle, "uniform", (-np.pi, 2 * np.pi)).pvalue > 1e-4
    assert abs(np.corrcoef(energy, length)[0, 1]) < 5 / np.sqrt(n)


def test_numbers_go_with_time_and_area(rays):
    """Poisson numbers of tracks that hit, 5 sigma; none in no time."""
    for shape, seconds in ((CHIP, 20.0), (CHIP, 320.0), ((400, 2000), 5e4)):
        tracks = draw_tracks(shape, seconds, rays, stream(3, "time", seconds))
        inside = [(a > -0.5) & (a < n - 0.5) for a, n in ((tracks.y, shape[0]), (tracks.x, shape[1]))]
        entered = (inside[0] & inside[1]).sum()
        expected = rays.rate * seconds * shape[0] * shape[1]
        assert abs(entered - expected) < 5 * np.sqrt(expected)
    pixel, electrons, hits = deposit(CHIP, draw_tracks(CHIP, 0.0, rays, stream(3, "none")), 0.2, KEY)
    assert len(pixel) == len(electrons) == hits == 0


def test_a_track_is_a_straight_line():
    """Before diffusion a slanted track gives each pixel the share of its way that lies in it, to one electron."""
    x, y, dx, dy, n = 3.2, 5.9, 7.0, -4.0, 10_000
    pixel, electrons, hits = deposit((12, 15), tracks_of(x, y, dx, dy, n), 0.0, KEY)
    t = (np.arange(1_000_000) + 0.5) / 1e6
    cells = np.rint(y + dy * t).astype(int) * 15 + np.rint(x + dx * t).astype(int)
    wanted = np.bincount(cells, minlength=180) / 1e6
    assert hits == 1 and electrons.sum() == n
    np.testing.assert_array_equal(pixel, np.flatnonzero(wanted))
    np.testing.assert_allclose(electrons, n * wanted[pixel], atol=1.01)


def test_diffusion_is_a_gaussian():
    """A million electrons at a point off the pixel's centre: erf over the pixels, chi-square p > 1e-5."""
    sigma, x, y = 0.2, 10.3, 10.45
    pixel, electrons, _ = deposit((21, 21), tracks_of(x, y, 0, 0, 1_000_000), sigma, KEY)
    image = np.bincount(pixel, electrons, 441).reshape(21, 21)
    edges = np.arange(22) - 0.5
    share = np.outer(*(np.diff(stats.norm.cdf(edges, at, sigma)) for at in (y, x)))
    enough = share > 1e-5
    observed = np.r_[image[enough], image[~enough].sum()]
    expected = 1e6 * np.r_[share[enough], share[~enough].sum()]
    assert stats.chisquare(observed, expected * (1e6 / expected.sum())).pvalue > 1e-5


def test_every_electron_is_on_the_frame_or_beyond_its_edges(rays):
    """The same tracks on a frame so large that none leaves it: all charge is there, and inside it is the same."""
    shape, pad = (150, 200), 210
    tracks = draw_tracks(shape, 3e5, rays, stream(4, "edges"))
    pixel, electrons, hits = deposit(shape, tracks, 0.2, KEY)
    larger = (shape[0] + 2 * pad, shape[1] + 2 * pad)
    every, charge, all_hits = deposit(larger, tracks._replace(x=tracks.x + pad, y=tracks.y + pad), 0.2, KEY)
    image = np.bincount(every, charge, larger[0] * larger[1]).reshape(larger)
    assert image.sum() == tracks.electrons.sum() and all_hits == len(tracks.x) > hits > 0
    np.testing.assert_array_equal(image[pad:-pad, pad:-pad].ravel().nonzero()[0], pixel)
    np.testing.assert_array_equal(image[pad:-pad, pad:-pad].ravel()[pixel], electrons)


def test_nothing_is_lost_within_the_frame():
    rng = stream(5, "inside")
    tracks = tracks_of(*(rng.uniform(30, 170, 500) for _ in "xy"), *(rng.uniform(-20, 20, 500) for _ in "xy"),
                       rng.integers(1, 9000, 500))  # fmt: skip
    _, electrons, hits = deposit((200, 200), tracks, 0.2, KEY)
    assert electrons.sum() == tracks.electrons.sum() and hits == 500


def test_order_and_size_of_batches_do_not_matter_to_a_track():
    """A track has its electrons by its number: those before it change nothing."""
    tracks = tracks_of([20, 60], [20, 60], [5, 9], [3, -8], [4000, 3000])
    both = deposit((90, 90), tracks, 0.2, KEY)
    first = deposit((90, 90), tracks_of(20, 20, 5, 3, 4000), 0.2, KEY)
    here = both.pixel < 40 * 90
    np.testing.assert_array_equal(both.pixel[here], first.pixel)
    np.testing.assert_array_equal(both.electrons[here], first.electrons)


def test_a_frame_of_one_pixel(rays):
    tracks = draw_tracks((1, 1), 1e6, rays, stream(6, "one"))
    pixel, electrons, hits = deposit((1, 1), tracks, 0.2, KEY)
    assert pixel.tolist() == [0] and 0 < electrons[0] < tracks.electrons.sum() and hits >= 1


def test_a_box_holds_a_track_whichever_way_it_runs():
    tracks = tracks_of([10.2, 10.2], [20.6, 20.6], [5.0, -5.0], [-3.0, 3.0], [1, 1])
    x0, y0, x1, y1 = boxes(tracks, 2)
    assert x0.tolist() == [8, 3] and x1.tolist() == [19, 14]
    assert y0.tolist() == [15, 18] and y1.tolist() == [24, 27]


def test_tracks_start_anywhere_within_a_tracks_length_of_the_frame(rays):
    """Uniform over the frame and its margin in either direction (KS, p > 1e-4), and no further."""
    tracks = draw_tracks((200, 3000), 1e5, rays, stream(8, "starts"))
    margin = rays.long_max + np.ceil(9 * rays.diffusion)
    for place, n in ((tracks.x, 3000), (tracks.y, 200)):
        assert stats.kstest(place, "uniform", (-margin - 0.5, n + 2 * margin)).pvalue > 1e-4


def test_no_two_tracks_share_their_random_numbers():
    """600 points of 60 e- on pixels' centres, more than a batch: each is spread in its own way."""
    y, x = (20.0 * v.ravel() + 10 for v in np.mgrid[:20, :30])
    pixel, electrons, hits = deposit((400, 600), tracks_of(x, y, 0 * x, 0 * x, np.full(600, 60)), 1.0, KEY)
    image = np.bincount(pixel, electrons, 240_000).reshape(20, 20, 30, 20)
    spread = {image[i, :, j].tobytes() for i, j in np.ndindex(20, 30)}
    assert hits == 600 and electrons.sum() == 36_000 and len(spread) == 600


def test_electrons_that_diffuse_far_stay_where_they_fall():
    """A million electrons with sigma = 2 px, of which 60 fall beyond 4 sigma along each axis (chi-square, p > 1e-5)."""
    pixel, electrons, _ = deposit((61, 61), tracks_of(30, 30, 0, 0, 1_000_000), 2.0, KEY)
    image = np.bincount(pixel, electrons, 61 * 61).reshape(61, 61)
    assert image.sum() == 1_000_000
    expected = 1e6 * np.diff(stats.norm.cdf([-np.inf, *(np.arange(-9, 9) + 0.5), np.inf], scale=2.0))
    for axis in (0, 1):
        line = image.sum(axis=axis)
        observed = [line[:22].sum(), *line[22:39], line[39:].sum()]
        assert stats.chisquare(observed, expected).pvalue > 1e-5
