"""If one of four exposures is wrong, its own gate fails and names it, however few its sources are."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.wcs import WCS
from measure.bricks.fabricated_frame import PIX, SCALE, make_frame
from support.csst import BANDS

from csstsim.base.rng import stream
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.catalog.truth_bricks import ID_BITS
from csstsim.measure.bricks.merge import merge_brick
from csstsim.measure.bricks.validation.facts import (
    MIN_PIXELS,
    ChannelLevel,
    Facts,
    HeaderWCS,
    _faint_fraction,
    _object_background,
    _uneven,
    header_off,
    pixels_off,
)
from csstsim.measure.bricks.validation.gates import counts
from csstsim.measure.bricks.validation.gates.data import FrameData, clipped_mean
from csstsim.measure.bricks.validation.gates.record import MIN_SOURCES, SIGMAS_OF_MANY
from csstsim.measure.bricks.validation.gates.register import gate_named
from csstsim.measure.bricks.validation.gates.shapes import shape_slope
from csstsim.measure.bricks.validation.measured_frame import truth_inside
from csstsim.measure.bricks.validation.trials import joined, trials
from csstsim.measure.bricks.validation.validate import validate_brick
from csstsim.measure.bricks.validation.verdict import sentence, verdict_of_results

EXPTIME, SKY, DARK, READ_NOISE, GAIN, RESPONSE = 150.0, 31.0, 3.0, 5.0, 1.1, 0.95
CHANNELS = 5, 6
SIDE = 2300  # px of the fabricated frame
GALAXIES = "shape response minus 1"
LEVEL, NOISE = "background over sky and dark, less 1", "noise over that of sky, dark and readout, less 1"
UNEVEN, POINTING = "background of a channel over that of all, less 1", "header: pointing less the campaign's [arcsec]"
OVERSCAN, BIAS = "read noise of the overscan over the camera's, less 1", "bias of the overscan less the header's [DN]"


def header_wcs(frame, shift=0.0):
    """Return the HeaderWCS that the lattice of a fabricated frame lies on, its reference `shift` px beside."""
    x, y = frame.truth["x"], frame.truth["y"]
    cards = {
        "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": float(frame.truth["ra_epoch"].mean()),
        "CRVAL2": float(frame.truth["dec_epoch"].mean()), "CRPIX1": float(x.mean()) + 1 + shift,
        "CRPIX2": float(y.mean()) + 1, "CD1_1": SCALE, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": SCALE,
    }  # fmt: skip
    return HeaderWCS(cards)


def whole_frame(obsid, seed, sky=3):
    """A fabricated frame with pixels' figures, a header and galaxies' shapes, all as they should be."""
    frame = make_frame("g", seed, obsid=obsid, scatter=3.0, sky=sky)
    rng, n = stream(sky, "shapes"), len(frame.truth)
    wcs = header_wcs(frame)
    galaxy = frame.truth["obj_type"] == GALAXY
    ra, dec = WCS(dict(wcs.cards)).all_pix2world(frame.truth["x"], frame.truth["y"], 0)
    shape = 0.25 * rng.standard_normal((2, n)).clip(-2, 2) * galaxy
    truth = frame.truth.with_columns(
        id=(np.int64(PIX) << ID_BITS) + frame.truth["id"], e1=shape[0], e2=shape[1], g1=np.full(n, 0.02),
        g2=np.full(n, -0.01), ra=ra, dec=dec, drawn=np.zeros(n),
        snr=np.full(n, 100.0),
    )  # fmt: skip
    rows = frame.measured["number"]
    e, g = shape[0] + 1j * shape[1], 0.02 - 0.01j
    rng = stream(seed, "noise of shapes")
    seen = (e + g) / (1 + np.conj(g) * e) + 0.05 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    measured = frame.measured.with_columns(
        g1=seen.real[rows], g2=seen.imag[rows], resolution=np.where(galaxy, 0.8, 0.0)[rows]
    )
    facts = Facts(
        exptime=EXPTIME, sky=SKY, dark=DARK, read_noise=READ_NOISE, full_well=9e4, gain=dict.fromkeys(CHANNELS, GAIN),
        header={"exptime": EXPTIME, "gain": dict.fromkeys(CHANNELS, GAIN), "bias": dict.fromkeys(CHANNELS, 454.0),
                "read_noise": dict.fromkeys(CHANNELS, READ_NOISE)},
        wcs=wcs, expected={"galaxies": int(galaxy.sum()), "stars": int((~galaxy).sum())},
    )  # fmt: skip
    measured.meta["channels"] = [channel(facts, n, k) for k, n in enumerate(CHANNELS)]
    return replace(frame, truth=truth, measured=measured, facts=facts)


def channel(facts, number, place, **wrong):
    half = SIDE // 2
    return {
        "channel": number, "window": [place * half, (place + 1) * half, 0, SIDE], "bias": 454.0,
        "read_noise": np.hypot(READ_NOISE, GAIN / np.sqrt(12)), "level": facts.level(RESPONSE),
        "noise": facts.noise(RESPONSE, number), "response": RESPONSE, "overscan": 20_000,
    } | wrong  # fmt: skip


@pytest.fixture(scope="module")
def frames():
    return [whole_frame(str(k), 30 + k) for k in range(1, 5)]


def gates(frames):
    sources, _ = merge_brick(PIX, [frame.measured for frame in frames], BANDS)
    return validate_brick(PIX, sources, frames, BANDS, ValidateConfig())[0]["gates"]


def measured(frame, **columns):
    return replace(frame, measured=frame.measured.with_columns(**columns))


def in_channel(frame, **factors):
    """Return a frame whose second channel has figures that are wrong by factors."""
    table = frame.measured.take(slice(None))
    first, second = frame.info["channels"]
    table.meta["channels"] = [first, second | {name: second[name] * factor for name, factor in factors.items()}]
    return replace(frame, measured=table)


def header(frame, **changes):
    return replace(frame, facts=replace(frame.facts, header=frame.facts.header | changes))


def lost(frame, kind, share):
    """Return a frame whose table lost a share of the galaxies (kind 1) or stars (0)."""
    of_kind = frame.truth["obj_type"][frame.measured["number"]] == kind
    keep = ~of_kind | (stream(2, "lost").uniform(size=len(of_kind)) > share)
    return replace(frame, measured=frame.measured.take(keep))


FAULTS = {
    "noise twice as large": (lambda f: in_channel(f, noise=2.0), NOISE),
    "sky 5% too bright": (lambda f: in_channel(f, level=1.05), LEVEL, UNEVEN),
    "a channel without light": (lambda f: in_channel(f, level=0.0), LEVEL, UNEVEN),
    "2% of gain in the pixels of half a frame": (lambda f: in_channel(f, level=0.98), LEVEL, UNEVEN),
    "RA_PNT0 0.01 deg off": (lambda f: header(f, pointing={"RA_OBJ": 0.0, "RA_PNT0": 27.6}), POINTING),
    "galaxies that were not selected": (
        lambda f: replace(f, truth=f.truth.take((f.truth["obj_type"] != GALAXY) | (f.truth["id"] % 50 > 0))),
        "galaxies of a frame over the catalogue's, less 1",
    ),
    "read noise 20% larger": (lambda f: in_channel(f, read_noise=1.2), OVERSCAN),
    "a true gain 2% off": (lambda f: in_channel(f, bias=1 / 1.02), BIAS),
    "GAIN 2% off": (lambda f: header(f, gain={5: GAIN, 6: 1.02 * GAIN}), "header: gain over the camera's, less 1"),
    "RON 2% off": (
        lambda f: header(f, read_noise={5: 5.0, 6: 5.1}), "header: read noise over the camera's, less 1",
    ),
    "EXPTIME 1 s off": (lambda f: header(f, exptime=149.0), "header: exposure time over the campaign's, less 1"),
    "header's WCS 0.3 px off": (
        lambda f: replace(f, facts=replace(f.facts, wcs=header_wcs(f, 0.3))), "position by the header's WCS [px]",
    ),
    "code's WCS 0.3 px off": (
        lambda f: measured(f, dec=f.measured["dec"] + 0.3 * SCALE), "astrometric offset of an exposure [mas]",
    ),
    "zero point 2% off": (
        lambda f: measured(f, mag_psf=f.measured["mag_psf"] + 0.0217), "zero point of an exposure [mag]",
    ),
    "stars 2% too wide": (
        lambda f: measured(f, hsm_sigma=1.02 * f.measured["hsm_sigma"]), "star size over PSF model, less 1",
    ),
    "sign of g2": (lambda f: measured(f, g2=-f.measured["g2"]), GALAXIES),
    "position angle 15 degrees off": (
        lambda f: measured(f, g1=turned(f).real, g2=turned(f).imag), GALAXIES,
    ),
    "a quarter of the galaxies": (lambda f: lost(f, GALAXY, 0.25), "completeness of galaxies"),
    "a fifth of the stars": (lambda f: lost(f, 0, 0.2), "completeness"),
}  # fmt: skip


def turned(frame):
    return (frame.measured["g1"] + 1j * frame.measured["g2"]) * np.exp(2j * np.radians(15.0))


@pytest.mark.parametrize("fault", FAULTS)
def test_one_exposure_of_four_fails_its_gate_and_is_named(frames, fault):
    wrong, *names = FAULTS[fault]
    found = gates([frames[0], wrong(frames[1]), *frames[2:]])
    failing = [gate for gate in found if gate["passed"] is False and "exposure" in gate]
    assert {gate["name"] for gate in failing} == set(names)
    assert all(gate["exposure"] == "2" for gate in failing) and max(gate["margin"] for gate in failing) > 1.5
    said = min((sentence(gate) for gate in verdict_of_results([{"brick": PIX, "gates": failing}])["gates"]), key=len)
    assert said.startswith(f"brick {PIX}, exposure 2, chip 10") and any(f": {name} in g is " in said for name in names)
    if "channel" in fault or fault.startswith(("GAIN", "a true gain")):
        assert any("channel 6" in sentence(gate) for gate in failing)


def test_without_a_fault_none_fails_in_ten_seeds():
    for seed in range(10):
        found = gates([whole_frame(str(k), 100 + 10 * seed + k, seed) for k in range(2)])
        assert not [gate for gate in found if gate["passed"] is False]


def test_wings_of_objects_are_no_sky(frames):
    """A bright star lifts the level by 1% of its light; nothing else may."""
    lit = in_channel(frames[0], level=1.05)
    light = 0.05 * frames[0].info["channels"][1]["level"] * SIDE * SIDE / 2
    star = np.where(np.arange(len(lit.truth)) == np.argmax(lit.truth["x"]), light / 0.015, 0.0)
    found = {gate["name"]: gate for gate in gates([replace(lit, truth=lit.truth.with_columns(drawn=star))])}
    assert found[LEVEL]["passed"] is True
    found = {gate["name"]: gate for gate in gates([replace(lit, truth=lit.truth.with_columns(drawn=0.1 * star))])}
    assert found[LEVEL]["passed"] is False


@pytest.mark.parametrize(("beyond", "passes"), [(140.0, True), (0.0, False)])
def test_a_bright_star_beyond_the_edge_is_no_sky(frames, beyond, passes):
    """All its light that falls into the frame is that of wings; of a star within, nearly none is seen as background."""
    lit = in_channel(frames[0], level=1.05)
    light = 0.05 * frames[0].info["channels"][1]["level"] * SIDE * SIDE / 2
    last = np.arange(len(lit.truth)) == np.argmax(lit.truth["x"])
    edge = lit.info["channels"][1]["window"][1]
    star = lit.truth.with_columns(drawn=1.1 * light * last, x=np.where(last, edge - 1 + beyond, lit.truth["x"]))
    found = {gate["name"]: gate for gate in gates([replace(lit, truth=star)])}
    assert found[LEVEL]["passed"] is passes
    assert found["background of a channel over that of all, less 1"]["passed"] is passes


@pytest.mark.parametrize(("size", "index", "passes"), [(16.0, 4.0, True), (4.0, 0.5, False), (1.0, 4.0, False)])
def test_outskirts_of_a_large_galaxy_are_no_sky(frames, size, index, passes):
    """A third of the light of a nearby elliptical galaxy lies below a pixel's noise; a compact one's does not."""
    lit = in_channel(frames[0], level=1.05)
    light = 0.05 * frames[0].info["channels"][1]["level"] * SIDE * SIDE / 2
    truth = lit.truth
    one = (np.arange(len(truth)) == np.argmax(truth["x"] * (truth["obj_type"] == GALAXY))).astype(float)
    large = truth.with_columns(
        drawn=4 * light * one, bulge_frac=one, size_disk=0 * one, size_bulge=size * one,
        n_bulge=np.full(len(truth), index),
    )  # fmt: skip
    found = {gate["name"]: gate for gate in gates([replace(lit, truth=large)])}
    assert found[LEVEL]["passed"] is passes


def test_pixels_too_few_and_sky_unknown_evaluate_nothing(frames):
    frame = in_channel(frames[0], level=2.0)
    unknown = replace(frame, facts=replace(frame.facts, sky=None))
    assert not {gate["name"] for gate in gates([unknown])} & {LEVEL, NOISE}
    small = frame.measured.take(slice(None))
    side = int(np.sqrt(MIN_PIXELS)) // 2
    small.meta["channels"] = [part | {"window": [0, side, 0, side]} for part in frame.info["channels"]]
    assert not {gate["name"] for gate in gates([replace(frame, measured=small)])} & {LEVEL, NOISE}


def test_header_without_numbers_is_not_evaluated(frames):
    bare = replace(frames[0], facts=replace(frames[0].facts, header={}, wcs=None))
    found = {gate["name"]: gate for gate in gates([bare])}
    assert found["position by the header's WCS [px]"]["passed"] is None
    assert not any(name.startswith("header:") for name in found) and BIAS not in found


@pytest.mark.parametrize(("depth", "off"), [(25.7, -0.2), (25.95, 0.0), (26.0, 0.0), (26.1, 0.0), (26.4, 0.3)])
def test_depth_is_tested_against_the_range_of_the_published_ones(depth, off):
    frame = SimpleNamespace(info={"depth_5sigma": depth}, depth=(25.9, 26.1))
    gate = gate_named("depth beyond the published limits [mag]")
    (result,) = gate.evaluate(FrameData(frame, None, PIX, None), ValidateConfig(), "r")
    assert result["value"] == pytest.approx(off) and result["threshold"] == ValidateConfig().depth_off_max
    frame.depth = None
    assert gate.evaluate(FrameData(frame, None, PIX, None), ValidateConfig(), "r") == []


def test_saturated_stars_lose_their_flag(frames):
    """Stars of twice the full well carry the flag; there must be MIN_SOURCES of them."""
    frame = replace(frames[0], facts=replace(frames[0].facts, full_well=2e3))
    table = trials(truth_inside(frame), frame)
    some = table["full"] > 0
    assert some.sum() > MIN_SOURCES and (frame.truth["obj_type"][0] == 0)
    name = "saturated stars with the flag"
    flagged = measured(frame, flags=np.full(len(frame.measured), 4, np.int32))
    found = {gate["name"]: gate for gate in gates([flagged])}
    assert found[name]["passed"] is True and found[name]["n"] == some.sum()
    assert {gate["name"]: gate for gate in gates([frame])}[name]["passed"] is False
    assert {gate["name"]: gate for gate in gates([frames[0]])}[name]["passed"] is None


def test_clipped_mean_has_the_error_it_states():
    """300 samples of 40 values with outliers: the pulls of the mean have a width of 1 within 5 sigma."""
    rng, pulls = stream(9, "clipped"), []
    for _ in range(300):
        errors = rng.uniform(0.5, 2.0, 40)
        values = 3.0 + errors * rng.standard_normal(40)
        values[:2] += 50.0
        mean, sigma, n = clipped_mean(values, errors, 0.1)
        pulls.append((mean - 3.0) / sigma)
        assert n <= 38
    assert np.std(pulls) == pytest.approx(1.0, abs=0.05 + 5 / np.sqrt(2 * 300))
    assert clipped_mean(np.array([np.nan]), np.array([1.0]), 0.1) == (None, 0.0, 0)


@pytest.mark.parametrize(("wrong", "slope"), [
    (lambda g: g, 1.0), (lambda g: 0.9 * g, 0.9), (lambda g: g * np.exp(0.6j), np.exp(0.6j)), (np.conj, 0.0),
])  # fmt: skip
def test_slope_of_shapes(wrong, slope):
    rng, n = stream(3, "slope"), 2000
    true = 0.3 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    got = wrong(true) + 0.1 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    columns = dict(zip(("true_g1", "true_g2", "g1", "g2"), (true.real, true.imag, got.real, got.imag), strict=True))
    blank = {name: np.zeros(n) for name in joined([]).names}
    table = ObjectTable(blank | columns | {"galaxy": np.ones(n), "snr": np.full(n, 50.0)})
    found, error, count = shape_slope(table)
    assert count > 0.95 * n and abs(found - slope) < 5 * error * np.sqrt(2) + 0.02


def uneven(excess, light=0.001):
    """Return [(channel, value, chance)] of eight channels, four in a row, whose backgrounds are off by `excess`."""
    corners = [(100 * (k % 4), 200 * (k // 4)) for k in range(8)]
    windows = [(x, x + 100, y, y + 200) for x, y in corners]
    pairs = zip(windows, excess, strict=True)
    return _uneven([ChannelLevel(k, window, 20_000, off, light, 1e-3) for k, (window, off) in enumerate(pairs, 1)])


def test_one_channel_that_is_off_is_named():
    found = uneven([0.02, *[0.0] * 7])
    assert {channel for channel, *_ in found} == {*range(1, 9), None} and len(found) == 10  # halves in x, and in y
    assert max(found, key=lambda row: abs(row[1]))[:2] == (1, pytest.approx(0.02 * 7 / 8))


def test_halves_are_compared_with_each_other():
    left = [0.02 if k % 4 < 2 else 0.0 for k in range(8)]
    found = uneven(left)
    assert {channel: value for channel, value, _ in found if channel}[1] == pytest.approx(0.01)
    halves = [(value, chance) for channel, value, chance in found if channel is None]
    assert max(abs(value) for value, _ in halves) == pytest.approx(0.02) and min(abs(v) for v, _ in halves) < 1e-12
    assert all(chance == pytest.approx(1e-3 * np.sqrt(2 / 4)) for _, chance in halves)


def test_light_that_differs_is_allowed_for():
    pairs = (1, 0.004, 0.01), (2, 0.0, 0.0)
    levels = [ChannelLevel(k, (k, k + 1, 0, 1), 10**5, off, light, 0.0) for k, off, light in pairs]
    assert {value for _, value, _ in _uneven(levels)} == {0.0}
    assert _uneven(levels[:1]) == []


def test_a_clipped_mean_by_hand():
    """Sigmas 0.5 and 1.5 with the floor: weights 4 and 4/9 about a median of 1; the last is off by more than 4."""
    values, errors = np.array([1.0, 1.0, 2.8, 9.0, np.nan, 1.0]), np.array([0.3, 0.3, np.sqrt(2.09), 0.3, 0.3, np.nan])
    mean, error, n = clipped_mean(values, errors, 0.4)
    weight = np.array([4.0, 4.0, 4 / 9])
    expected = weight @ [1, 1, 2.8] / weight.sum()
    scatter = np.sqrt(weight**2 @ (np.array([1, 1, 2.8]) - expected) ** 2) / weight.sum()
    assert (mean, n) == (pytest.approx(expected), 3) and error == pytest.approx(max(weight.sum() ** -0.5, scatter))
    apart = np.array([-10.0, 10.0, -10.0, 10.0])  # the scatter is larger than the errors
    assert clipped_mean(apart, np.full(4, 3.0), 4.0) == (0.0, pytest.approx(5.0), 4)


def test_objects_of_a_frame_are_counted_on_the_window_and_the_brick():
    n, ids = 8, np.arange(8) + (np.int64(PIX) << ID_BITS)
    truth = ObjectTable({
        "id": ids + (np.arange(n) == 3) * (1 << ID_BITS), "x": np.array([9.4, 9.6, 20, 20, 20, 20, 39.4, 39.6]),
        "y": np.array([50, 50, 119.6, 50, 50, 99.6, 100, 100.0]),
        "obj_type": np.array([0, 0, 0, 0, GALAXY, STAR, GALAXY, GALAXY]),
    })  # fmt: skip
    info = {"window": [10, 40, 20, 120], "obsid": "4", "chip": 9}
    frame = SimpleNamespace(
        truth=truth, info=info, band="r", facts=SimpleNamespace(expected={"galaxies": 4, "stars": 8})
    )
    galaxies, stars = counted(frame, ValidateConfig(frame_counts_max=0.05))
    assert galaxies["name"] == "galaxies of a frame over the catalogue's, less 1" and galaxies["value"] == -0.5
    assert (stars["value"], stars["threshold"], stars["n"]) == (-0.75, 0.05, 8)
    assert {k: stars[k] for k in ("band", "exposure", "chip")} == {"band": "r", "exposure": "4", "chip": 9}
    assert stars["error"] == pytest.approx(counts.BORDER / 8 / SIGMAS_OF_MANY)
    frame.facts.expected = {"stars": 0}
    assert counted(frame)[0]["value"] is None
    for facts in (SimpleNamespace(expected={}), None):
        frame.facts = facts
        assert counted(frame) == []


def counted(frame, thresholds=None):
    """Return the results of the gates of a frame's numbers of objects."""
    data = FrameData(frame, None, PIX, thresholds or ValidateConfig())
    gates = [gate for gate in counts.GATES if gate.scope == "frame"]
    return [result for gate in gates for result in gate.evaluate(data, data.thresholds, frame.band, **data.where)]


def odd_facts(**changes):
    """Sky 20, dark current 3, read noise 4 electrons; gains 2 and 3."""
    numbers = {
        "exptime": 150.0,
        "sky": 20.0,
        "dark": 3.0,
        "read_noise": 4.0,
        "full_well": 9e4,
        "gain": {1: 2.0, 2: 3.0},
    }
    return Facts(**(numbers | changes))


def test_expected_background_and_noise_are_of_the_light_before_the_flat():
    assert odd_facts().level(0.5) == pytest.approx(26.0)
    assert odd_facts().noise(0.5, 2) == pytest.approx(np.sqrt(10 + 3 + 16 + 9 / 12) / 0.5)
    assert odd_facts().noise(1.0, 7) == pytest.approx(np.sqrt(39.0))


def odd_channels():
    """Two channels of 320 x 400 and 640 x 400 px, the second 4% too bright; responses 0.5 and 0.6."""
    common = {"read_noise": 4.1, "bias": 101.0}
    return [
        common | {"channel": 1, "window": [100, 420, 0, 400], "level": 26.0, "noise": 12.0, "response": 0.5,
                  "overscan": 800},
        common | {"channel": 2, "window": [420, 1060, 0, 400], "level": 26.0, "noise": 11.0, "response": 0.6,
                  "overscan": 0},
    ]  # fmt: skip


def test_pixels_against_what_is_expected_by_hand():
    """No light of objects. The whole frame has means weighted with 1 and 2 thirds."""
    facts = odd_facts(header={"bias": {1: 100.5, 2: 7.0}})
    out = pixels_off(odd_channels(), facts, {}, 0.074)
    n = np.array([384_000, 128_000, 256_000])
    level, noise, response = [26.0, 26.0, 26.0], [34 / 3, 12.0, 11.0], np.array([1.7 / 3, 0.5, 0.6])
    expected = 20 + 3 / response
    sigma = np.hypot(np.array(noise) / np.sqrt(n), [4 / 800**0.5, 4 / 800**0.5, 0.0])
    for k, channel in enumerate((None, 1, 2)):
        assert out["level"][k] == (channel, pytest.approx(level[k] / expected[k] - 1, abs=1e-12),
                                   pytest.approx(sigma[k] / expected[k]))  # fmt: skip
        gain = {None: 2.0, 1: 2.0, 2: 3.0}[channel]
        right = np.sqrt(20 * response[k] + 3 + 16 + gain**2 / 12) / response[k]
        assert out["noise"][k] == (channel, pytest.approx(noise[k] / right - 1), pytest.approx((2 * n[k]) ** -0.5))
    assert out["read_noise"] == [(1, pytest.approx(4.1 / np.sqrt(16 + 4 / 12) - 1), pytest.approx(1 / 40))]
    assert out["bias"] == [(1, pytest.approx(0.5), pytest.approx(np.hypot(4.1 / 2, 12**-0.5) / 800**0.5))]
    off = out["uneven"][1][1]
    assert off == pytest.approx((1 / 25) * 1 / 3) and out["uneven"][0][1] == pytest.approx(-(1 / 25) * 2 / 3)


def test_light_of_objects_that_a_background_may_have():
    """Faint objects count whole, others by a fiftieth, those beyond the edge in the nearest channel."""
    channels = odd_channels()
    truth = ObjectTable({
        "x": np.array([150.0, 300.0, 800.0, 1200.0, 500.0]), "y": np.array([10.0, 10.0, 10.0, 10.0, -1.0]),
        "drawn": np.array([1000.0, 5000.0, 30_000.0, 700.0, np.nan]), "snr": np.array([4.9, 5.1, 90.0, 90.0, 90.0]),
    })  # fmt: skip
    wings = _object_background(channels, np.array([128_000, 256_000]), truth, 0.074)
    own = np.array([1000 + 100.0, 600 + 700.0])
    assert wings == pytest.approx(own / [128_000, 256_000] + own.sum() / 384_000)
    assert (
        _object_background(channels, np.array([1, 1]), {}, 0.074).tolist() == [0, 0]
        and len(_object_background([], [], truth, 0.074)) == 0
    )


def test_the_flux_of_a_large_galaxy_is_shared_by_the_channels_around_it():
    """Half each on the border of two channels; all in one at three radii from it; a small galaxy in its own alone."""
    channels = [{"window": (x, x + 1000, 0, 2000), "noise": 1e9} for x in (0, 1000)]  # all is below this noise

    def each(x, half):
        truth = ObjectTable({
            "obj_type": np.array([GALAXY]), "size_disk": np.array([half]), "size_bulge": np.zeros(1),
            "bulge_frac": np.zeros(1), "x": np.array([x]), "y": np.array([900.0]), "drawn": np.array([4e6]),
            "snr": np.array([900.0]),
        })  # fmt: skip
        both = _object_background(channels, np.array([2_000_000, 2_000_000]), truth, 1.0)
        own = both - both.sum() / 4  # without the mean of the frame
        return own / own.sum()

    assert each(999.0, 200.0) == pytest.approx([0.5, 0.5], abs=0.04)
    assert each(399.0, 200.0) == pytest.approx([1.0, 0.0], abs=0.02) and each(1700.0, 200.0)[0] == 0.0
    assert each(990.0, 20.0) == pytest.approx([1.0, 0.0])
    assert each(1.0, 300.0).sum() == pytest.approx(1.0)


def test_the_outskirts_of_an_exponential_disk_are_those_below_the_noise():
    """I(r) = F / (2 pi h^2) exp(-r / h): beyond r the share (1 + r / h) exp(-r / h) of the light is left."""
    half, drawn, noise = 40.0, 5e5, 12.0  # px, electrons
    truth = ObjectTable({
        "obj_type": np.array([GALAXY, GALAXY, STAR]), "size_disk": np.array([2.0, 1.5, 2.0]),
        "size_bulge": np.zeros(3), "bulge_frac": np.zeros(3),
    })  # fmt: skip
    h = half / 1.67835
    radius = np.log(drawn / (2 * np.pi * h**2) / noise)
    share = _faint_fraction(truth, np.full(3, drawn), noise, 0.05)
    assert share == pytest.approx([(1 + radius) * np.exp(-radius), 0.0, 0.0], rel=1e-3)


def test_the_header_against_the_campaign_by_hand():
    header = {
        "exptime": 153.0,
        "gain": {1: 2.2, 2: 2.7, 9: 1.0},
        "read_noise": {2: 5.0},
        "pointing": {"A": 0.1, "B": 0.4},
    }
    assert header_off(odd_facts(header=header)) == {
        "exptime": [(None, pytest.approx(0.02), 0.0)],
        "gain": [(1, pytest.approx(0.1), 0.0), (2, pytest.approx(-0.1), 0.0)],
        "read_noise": [(2, pytest.approx(0.25), 0.0)], "pointing": [(None, 0.4, 0.0)],
    }  # fmt: skip
    empty = {"exptime": [], "gain": [], "read_noise": [], "pointing": []}
    assert header_off(odd_facts(header={})) == empty
    assert header_off(odd_facts(exptime=0.0, read_noise=0.0, gain={}, header=header | {"pointing": {}})) == empty


def test_distortion_is_undone_before_the_headers_linear_map():
    wcs = header_wcs(make_frame("g", 1, side=2))
    moved = HeaderWCS(wcs.cards, SimpleNamespace(inverse=lambda x, y: (x + 2.0, y - 3.0)))
    x, y = np.array([10.0, 90.0]), np.array([20.0, 60.0])
    assert moved.pixel_to_world(x, y) == pytest.approx(np.array(wcs.pixel_to_world(x + 2.0, y - 3.0)), abs=1e-12)


@pytest.mark.parametrize(("snr", "galaxy", "counts"), [(20.1, 1, 1), (19.9, 1, 0), (500.1, 1, 0), (50.0, 0, 0)])
def test_whose_shapes_make_the_slope(snr, galaxy, counts):
    """Three galaxies of slope 2i; the fourth, of slope 0, counts or not."""
    columns = {name: np.zeros(4) for name in joined([]).names}
    columns |= {
        "galaxy": np.array([1, 1, 1, galaxy]), "snr": np.array([50.0, 50.0, 50.0, snr]),
        "true_g1": np.array([0.1, 0.0, 0.2, 0.3]), "true_g2": np.array([0.0, 0.2, 0.1, 0.0]),
        "g1": np.array([0.0, -0.4, -0.2, 0.0]), "g2": np.array([0.2, 0.0, 0.4, 0.0]),
    }  # fmt: skip
    slope, error, n = shape_slope(ObjectTable(columns))
    assert n == 3 + counts and slope == pytest.approx(2j * (0.1 / 0.19 if counts else 1.0))
    square = 0.1 * abs(2j - slope) ** 2 + 0.09 * abs(slope) ** 2 * counts
    assert error == pytest.approx(np.sqrt(square / (2 * (n - 1)) / (0.1 + 0.09 * counts)))
    assert shape_slope(ObjectTable(columns).take([0])) == (None, 0.0, 1)
