"""Validation against fabricated truth whose completeness, bias and scatter are known; the figures."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from measure.bricks.fabricated_frame import N_EFF, PIX, RMS, SCALE, ZEROPOINT, make_frame
from support.csst import BANDS, LOOKS, PIXEL

from csstsim.base import healpix
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.catalog import flags
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.merge import merge_brick
from csstsim.measure.bricks.validation.compare import counts, duplicates
from csstsim.measure.bricks.validation.gates.counts import CLUSTERING
from csstsim.measure.bricks.validation.gates.data import BrickData
from csstsim.measure.bricks.validation.gates.record import SIGMAS, SIGMAS_OF_MANY
from csstsim.measure.bricks.validation.gates.register import evaluate
from csstsim.measure.bricks.validation.measured_frame import EDGE, MeasuredFrame, blended, crowd, distinct, truth_inside
from csstsim.measure.bricks.validation.trials import close_pairs, matched, trials
from csstsim.measure.bricks.validation.validate import _exposure_statistics, completeness, validate_brick
from csstsim.report.figures import brick_figure, sky_map

DEPTH = ("depth beyond the published limits [mag]",)  # known without sources


def run(frames, **limits):
    sources, _ = merge_brick(PIX, [frame.measured for frame in frames], BANDS)
    return validate_brick(PIX, sources, frames, BANDS, ValidateConfig(**limits))


def gate(result, name, band):
    return next(g for g in result["gates"] if name in g["name"] and g["band"] == band)


def failing(result):
    """Return {(name, band)} of the gates that fail."""
    return {(g["name"], g["band"]) for g in result["gates"] if g["passed"] is False}


def test_counts_are_of_the_objects_in_frames_of_the_band():
    """r sees all of a field, g a third of it: what g never saw is not lost to it; what it saw and lost is."""
    r, g = make_frame("r", 3), make_frame("g", 3)
    part = g.truth["x"] < 750.0
    seen = g.measured.take(g.measured["x"] < 750.0)
    seen.meta["window"] = [0, 800, 0, g.info["window"][3]]
    g = replace(g, truth=g.truth.take(part), measured=seen)
    result, _ = run([r, g])
    assert result["bands"]["g"]["counts"]["n"] < 0.5 * result["bands"]["r"]["counts"]["n"]
    assert abs(gate(result, "number counts", "g")["value"]) < 0.02 and gate(result, "number counts", "g")["passed"]
    lost, _ = run([r, replace(g, measured=seen.take(np.arange(len(seen)) % 2 == 0))])
    assert gate(lost, "number counts", "g")["passed"] is False


def test_completeness_counts():
    snr, found = np.array([0.5, 1.5, 1.6, 7.0, 7.5, 900.0]), np.array([1, 1, 0, 1, 1, 1], bool)
    n, seen = completeness(snr, found, (1, 2, 5, 10))
    assert n.tolist() == [2, 0, 2] and seen.tolist() == [1, 0, 2]


def test_close_pairs_by_hand():
    """Of five pairs within 12 px, two of a bright and a faint one; the fainter of the first is the first detection."""
    x = np.array([5.0, 15.0, 205.0, 215.0, 405.0, 416.9, 605.0, 618.0, 800.0, 805.0])
    electrons = np.array([2e4, 4e4, 3e4, 3.1e4, 3e4, 4e4, 3e4, 4e4, 60.0, 3e4])
    truth = ObjectTable({
        "x": x, "y": np.full(len(x), 50.0), "electrons": electrons, "half_light_px": np.zeros(len(x)),
        "obj_type": np.zeros(len(x), int),
    })  # fmt: skip
    measured = ObjectTable({"x": x[[0, 1, 3, 4, 5, 7, 9]], "y": np.full(7, 50.0)})
    frame = replace(make_frame("r", 1, side=2), truth=truth, measured=measured)
    frame.measured.meta.update(n_eff=N_EFF, rms=RMS)
    assert close_pairs(truth, frame).tolist() == [2, 3]  # not the pair 13 px apart, nor the one of S/N 3
    empty = frame.truth.take(np.zeros(0, int))
    assert close_pairs(empty, frame).tolist() == [0, 0]


def test_a_galaxy_is_matched_within_half_its_half_light_radius():
    """Of 3", 20.3 px from the middle; one of 0.2" and a star within 2.5 px."""
    truth = ObjectTable({
        "x": np.arange(4) * 100.0, "y": np.zeros(4), "obj_type": np.array([1, 1, 1, 0]),
        "size_disk": np.array([3.0, 3.0, 0.2, np.nan]), "size_bulge": np.full(4, 0.1), "bulge_frac": np.zeros(4),
    })  # fmt: skip
    measured = ObjectTable({"x": np.array([20.0, 121.0, 202.6, 302.4]), "y": np.zeros(4)})
    assert matched(truth, measured, 0.074).tolist() == [0, -1, -1, 3]


def test_counts_have_stars_by_psf_and_galaxies_by_total_magnitudes():
    truth = ObjectTable({
        "mag_r": np.array([20.2, 21.2]), "blended": np.zeros(2, bool), "half_light_px": np.array([0.0, 2.0]),
    })  # fmt: skip
    sources = {
        "star": np.array([1.0, 0.2]), "mag_r": np.array([20.5, 23.5]), "total_mag_r": np.array([24.5, 21.5]),
        "n_r": np.array([1, 1]), "flux_r": np.ones(2), "flux_err_r": np.full(2, 0.01),
    }  # fmt: skip
    infos = [{"zeropoint": 31.5, "n_eff": 9.0, "rms": 7.7}]
    found = counts("r", truth, sources, np.array([0, 1]), np.ones(2, bool), np.arange(20.0, 26.0), infos)
    assert found["in"] == found["out"] == [1, 1, 0, 0, 0] and found["excess"] == 0.0 and found["n"] == 2


def test_blended_by_hand():
    x, y = np.array([0.0, 10.0, 100.0, 135.0, 300.0]), np.zeros(5)
    assert blended(x, y, np.array([100.0, 5.0, 10.0, 5000.0, 1.0])).tolist() == [False, True, True, False, False]
    assert blended(x[:0], y[:0], x[:0]).tolist() == []


def test_a_good_brick_passes_with_the_numbers_put_in():
    result, _ = run([make_frame(band, 1) for band in "gr"])
    for band in "gr":
        assert gate(result, "completeness", band) == {
            "name": "completeness", "band": band, "value": 1.0, "threshold": 0.95,
            "n": (n := result["bands"][band]["point_sources"]), "error": pytest.approx(1 / n),
            "margin": 0.0, "passed": True, "exposure": "1",
            "chip": 8 + BANDS.index(band),
        }  # fmt: skip
        star = result["bands"][band]["star"]
        assert gate(result, "magnitude", band)["passed"] and abs(star["median"]) < 5 * star["error"]
        assert result["bands"][band]["zeropoint"] == pytest.approx(ZEROPOINT - 2.5 * np.log10(150.0))
    for axis in ("east", "north"):
        part = result["astrometry_mas"][axis]
        assert part["sigma"] == pytest.approx(20.0 / np.sqrt(2), rel=5 / np.sqrt(part["n"]))  # two visits of 20 mas
        assert abs(part["median"]) < 5 * part["error"]
    json.dumps(result, allow_nan=False)


def test_completeness_of_a_detector_that_loses_the_faint():
    result, arrays = run([make_frame("g", 2, keep=0.1)])
    n, found = arrays["completeness"]["g"]
    fraction = found / np.maximum(n, 1)
    faint, bright = slice(3, 7), slice(7, 12)  # S/N 4 to 8, 8 to 100
    assert fraction[bright].min() == 1.0
    kept = found[faint].sum() / n[faint].sum()
    assert kept == pytest.approx(0.1, abs=5 * 0.3 / np.sqrt(n[faint].sum()))
    completeness_gate = gate(result, "completeness", "g")
    expected = found[4:12].sum() + found[12], n[4:12].sum() + n[12]
    assert completeness_gate["value"] == pytest.approx(expected[0] / expected[1]) and not completeness_gate["passed"]


@pytest.mark.parametrize(("shift", "passed"), [(0.05, False), (-0.05, False), (0.005, True)])
def test_a_shift_of_the_magnitudes_fails_in_its_band_only(shift, passed):
    result, _ = run([make_frame("g", 3, shift=shift), make_frame("r", 3)])
    assert gate(result, "magnitude bias of stars", "g")["value"] == pytest.approx(shift, abs=0.01)
    assert gate(result, "magnitude bias of stars", "g")["passed"] is passed
    assert gate(result, "magnitude bias of stars", "r")["passed"] is True


def test_no_threshold_or_few_sources_evaluate_nothing():
    off = dict.fromkeys(name for name in ValidateConfig.model_fields if not name.endswith("snr_min"))
    result, _ = run([make_frame("g", 4)], **off)
    assert {g["passed"] for g in result["gates"]} == {None} and len(result["gates"]) == len(
        run([make_frame("g", 4)])[0]["gates"]
    )
    result, _ = run([make_frame("g", 4, side=4)])
    assert {g["passed"] for g in result["gates"] if g["name"] not in DEPTH} == {None}
    assert gate(result, "completeness", "g")["n"] > 0


def changed(frame, **columns):
    """Return a frame with other measured columns."""
    return replace(frame, measured=frame.measured.with_columns(**columns))


FAULTS = {
    "a gain 5% too high": (
        lambda f: changed(f, flux_psf=1.05 * f.measured["flux_psf"]),
        {("magnitude bias of stars", "g"), ("width of stars' pulls", "g")},
    ),
    "a WCS one pixel off": (
        lambda f: changed(f, dec=f.measured["dec"] + SCALE),
        {("position residual at S/N > 50 [mas]", "all"), ("astrometric offset of an exposure [mas]", "g")},
    ),
    "total fluxes 0.13 mag too bright": (
        lambda f: changed(f, flux_total=10 ** (0.4 * 0.13) * f.measured["flux_total"]),
        {(f"magnitude bias of galaxies, S/N {bin_} [mag]", "g") for bin_ in ("10 to 20", "20 to 60", "60 to 500")},
    ),
    "light of the colours' aperture 5% too bright": (
        lambda f: changed(f, flux_gaap=1.05 * f.measured["flux_gaap"]),
        {(f"colour bias of galaxies, S/N {bin_} [mag]", "g - r") for bin_ in ("10 to 20", "20 to 500")},
    ),
    "places that follow the charge": (
        lambda f: changed(f, y=f.measured["y"] + 0.05), {("position bias, worst bin of S/N > 5 [mas]", "g")},
    ),
    "errors half as large": (
        lambda f: changed(f, flux_psf_err=0.5 * f.measured["flux_psf_err"]), {("width of stars' pulls", "g")},
    ),
    "errors twice as large": (
        lambda f: changed(f, flux_psf_err=2 * f.measured["flux_psf_err"]), {("width of stars' pulls", "g")},
    ),
    "stars 2% wider than the PSF model": (
        lambda f: changed(f, hsm_sigma=1.02 * f.measured["hsm_sigma"]), {("star size over PSF model, less 1", "g")},
    ),
    "stars longer than the PSF model": (
        lambda f: changed(f, hsm_e2=f.measured["hsm_e2"] - 0.03), {("star e2 less PSF model", "g")},
    ),
    "twice the noise": (
        lambda f: replace(f, depth=(26.65, 26.85)), {("depth beyond the published limits [mag]", "g")},
    ),
    "a frame without sources": (
        lambda f: replace(f, measured=f.measured.take(slice(0, 0))),
        {("completeness", "g"), ("completeness of galaxies", "g"), ("number counts, out / in - 1", "g")},
    ),
    "a third of the sources lost": (
        lambda f: replace(f, measured=f.measured.take(np.arange(len(f.measured)) % 3 > 0)),
        {("completeness", "g"), ("number counts, out / in - 1", "g")},
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_fails_its_gates_and_no_other(fault):
    broken, gates = FAULTS[fault]
    frame, other = (make_frame(band, 5, scatter=3.0) for band in "gr")
    assert failing(run([broken(frame), other])[0]) == gates
    assert failing(run([frame, other])[0]) == set()


def test_trials_take_another_codes_table():
    """Places and light are enough; what needs errors and shapes is NaN."""
    frame = make_frame("g", 7)
    names = "x", "y", "flux_psf", "flags"
    foreign = ObjectTable({name: frame.measured[name] for name in names}, frame.measured.meta)
    table = trials(truth_inside(frame), replace(frame, measured=foreign))
    found = table["found"]
    assert found.any() and np.isfinite(table["light"][found]).all()
    assert all(np.isnan(table[name]).all() for name in ("pull", "psf_size", "psf_e1", "psf_e2"))


def test_limits_and_transfer_are_those_put_in():
    """Half of all found at the magnitude of S/N 8; the lag of the upper half has the other sign."""
    frame = make_frame("g", 6, keep=0.0)
    lag = 0.1 * np.where(frame.measured["y"] > 1000, -1, 1)
    result, _ = run([replace(changed(frame, y=frame.measured["y"] + lag), seam=1000)])
    numbers = result["bands"]["g"]
    eight = 0.5 * 8 * (8 + np.sqrt(64 + 4 * N_EFF * RMS**2))
    assert numbers["half_found"]["star"] == pytest.approx(ZEROPOINT - 2.5 * np.log10(eight), abs=0.25)
    for part in numbers["transfer"]:
        if part["deferred_mas"]["n"] > 10:
            assert part["deferred_mas"]["median"] == pytest.approx(7.4, abs=5 * part["deferred_mas"]["error"])
            assert abs(part["across_mas"]["median"]) < 5 * part["across_mas"]["error"]
            assert abs(part["light"]["median"]) < 5 * part["light"]["error"]


@pytest.mark.parametrize("part", ["truth", "measured", "both", "no frame"])
def test_nothing_to_compare_is_no_crash(part):
    frame = make_frame("g", 5)
    truth = frame.truth.take(slice(0, 0)) if part in ("truth", "both") else frame.truth
    measured = frame.measured.take(slice(0, 0)) if part in ("measured", "both") else frame.measured
    result, arrays = run([] if part == "no frame" else [MeasuredFrame(truth, measured, 10_000, PIXEL)])
    json.dumps(result, allow_nan=False)
    if part == "no frame":  # the emptiest of the figures; the report's test draws a full one
        assert brick_figure(result, arrays, LOOKS).startswith(b"\x89PNG")
    if part == "measured":
        assert (
            gate(result, "completeness", "g")["value"] == 0.0 and gate(result, "completeness", "g")["passed"] is False
        )


def test_colours_out_follow_colours_in():
    frames = [make_frame(band, 6) for band in "ugr"]
    _, arrays = run(frames)
    given, got = arrays["colour"]["input"], arrays["colour"]["output"]
    assert given.shape[1] > 100 and got.shape[1] > 100
    assert np.allclose(given, 0.5, atol=1e-5)  # each band is half a magnitude bluer than the next
    assert np.allclose(np.median(got, axis=1), 0.5, atol=0.03)


def test_sky_map_of_nothing_at_a_pole_and_across_ra_zero():
    assert sky_map([], [], LOOKS).startswith(b"\x89PNG")
    for place in ((0.0, 0.0), (30.0, 90.0)):
        pix = int(healpix.brick_of(*place))
        corners = healpix.brick_corners(pix)
        assert sky_map([("nuv", *corners), ("gv", *corners)], [pix], LOOKS, [place]).startswith(b"\x89PNG")


def test_sky_map_of_opposite_fields():
    footprints = [("g", *healpix.brick_corners(int(healpix.brick_of(ra, 0.0)))) for ra in (10.0, 190.0)]
    assert sky_map(footprints, [], LOOKS, [(10.0, 0.0), (190.0, 0.0)]).startswith(b"\x89PNG")


def test_frame_reads_its_band_from_the_measured_table():
    frame = make_frame("nuv", 8)
    assert frame.info is frame.measured.meta and frame.band == "nuv"


def test_purity_counts_sources_without_a_true_object():
    frame = make_frame("g", 9)
    empty = run([frame])[0]
    assert empty["purity"] == 1.0 and empty["left_out"] >= 0
    lost = replace(frame, truth=frame.truth.take(slice(0, None, 2)))  # half of the true objects never existed
    result = run([lost])[0]
    assert result["purity"] == pytest.approx(0.5, abs=0.02) and ("purity", "all") in failing(result)
    assert run([MeasuredFrame(frame.truth, frame.measured.take(slice(0, 0)), frame.seam, PIXEL)])[0]["purity"] is None


def test_wide_galaxies_match_further_off_and_their_noise_is_that_of_their_area():
    frame = make_frame("g", 10)
    size = np.where(frame.truth["obj_type"] == 1, 0.5, 0.0)  # arcsec: match radius 0.25, noise 6.8 times a star's
    wide = frame.truth.with_columns(size_disk=size, size_bulge=size, bulge_frac=np.zeros(len(size)))
    away = frame.measured.with_columns(dec=frame.measured["dec"] + 0.225 / 3600.0)  # scatter 0.02
    pairs = (frame.truth, frame.measured), (frame.truth, away), (wide, away)
    near, lost, moved = (run([MeasuredFrame(truth, measured, 10_000, PIXEL)])[0] for truth, measured in pairs)
    count = [result["bands"]["g"]["galaxy"]["n"] for result in (near, lost, moved)]
    assert 0 < count[2] < 0.3 * count[0] and count[1] < 0.2 * count[0]
    assert 0.5 < moved["purity"] < 0.67 and lost["purity"] < 0.2  # 2 of 3 are galaxies


def test_sources_counted_twice_are_those_of_isolated_objects_with_a_source():
    """Of six objects four are alone with a source, one of them with two; the blend and the lost one do not count."""
    ra = 10.0 + 0.01 * np.arange(6)
    none = np.zeros(6)
    truth = {"ra_epoch": ra, "dec_epoch": none, "blended": np.array([0, 0, 0, 0, 0, 1]), "obj_type": none.astype(int)}
    truth |= {"size_disk": none, "size_bulge": none, "bulge_frac": none}
    sources = {"ra": np.concatenate([ra, ra[[2, 4, 5]] + 1e-6]), "dec": np.zeros(9)}
    assert duplicates(ObjectTable(truth), ObjectTable(sources), np.array([0, 1, 2, 3, -1, 5])) == (0.25, 4)


def of_band():
    """Numbers of a band: bins of galaxies, of charge transfer, stars, counts and pairs, all of different size."""
    spread = {"sigma": 1.0}
    return {
        "star": spread | {"median": -0.03, "error": 0.001, "n": 50}, "point_sources": 77,
        "counts": {"excess": -0.15, "n": 400}, "pairs": {"found": 30, "n": 60},
        "galaxy_bins": [
            spread | {"snr": [low, high], "median": off, "error": error, "n": n}
            for low, high, off, error, n in (
                (10, 20, 0.4, 0.05, 30), (20, 60, -0.2, 0.01, 40), (60, 500, 0.01, None, 3),
            )
        ],
        "transfer": [
            {name: spread | {"median": off, "error": error, "n": n} for name, off, error, n in rows}
            for rows in (
                (("deferred_mas", -3.0, 0.5, 25), ("across_mas", 1.5, 0.1, 25), ("light", 9.0, 0.0, 99)),
                (("deferred_mas", 0.2, 0.2, 30), ("across_mas", 90.0, 0.1, 19), ("light", 9.0, 0.0, 99)),
            )
        ],
    }  # fmt: skip


def test_gates_of_a_band_by_hand():
    """Of the four biases the largest less four errors is 1.5 - 0.4; that of 19 sources does not count."""
    config = SimpleNamespace(galaxy_mag_max=(0.15, 0.1, 0.05), pair_completeness_min=0.6, mag_bias_max=0.02,
                             position_bias_max=1.0, counts_max=0.1)  # fmt: skip
    rows = [
        ("magnitude bias of galaxies, S/N 10 to 20 [mag]", 0.4, 0.15, 30, 0.4 / (0.15 + SIGMAS * 0.05), False),
        ("magnitude bias of galaxies, S/N 20 to 60 [mag]", -0.2, 0.1, 40, 0.2 / (0.1 + SIGMAS * 0.01), False),
        ("magnitude bias of galaxies, S/N 60 to 500 [mag]", 0.01, 0.05, 3, None, None),
        ("completeness of the fainter of close pairs", 0.5, 0.6, 60, 0.5 / (0.4 + 2 * np.sqrt(0.24 / 60)), True),
        ("magnitude bias of stars", -0.03, 0.02, 50, 1.5, False),
        ("position bias, worst bin of S/N > 5 [mas]", 1.1, 1.0, 77, 1.1, False),
        ("number counts, out / in - 1", -0.15, 0.1, 400, 0.15 / (0.1 + SIGMAS * np.sqrt(0.1 / 400)), False),
    ]  # fmt: skip
    gates = evaluate("band", of_band(), config, "r")
    found = [tuple(gate[k] for k in ("name", "value", "threshold", "n", "margin", "passed")) for gate in gates]
    assert found == [(name, pytest.approx(v), t, n, m and pytest.approx(m), p) for name, v, t, n, m, p in rows]
    assert {gate["band"] for gate in gates} == {"r"}
    none = of_band() | {"pairs": {"found": 0, "n": 0}, "transfer": []}
    assert [gate["passed"] for gate in evaluate("band", none, config, "r")][3::2] == [None, None]


def test_gates_of_colours_and_laws_by_hand():
    part = {"bands": ["g", "r"], "snr": [10.0, 20.0], "median": -0.05, "error": 0.01, "n": 30}
    (gate,) = evaluate("colour", part, ValidateConfig(galaxy_colour_max=0.03), "g - r")
    assert (gate["name"], gate["band"]) == ("colour bias of galaxies, S/N 10 to 20 [mag]", "g - r")
    assert gate["margin"] == pytest.approx(0.05 / (0.03 + SIGMAS * 0.01)) and gate["error"] == pytest.approx(0.01)
    laws = {"stars": (140, 100.0), "galaxies": (380, 400.0), "quasars": (3, 0.0)}
    nothing = None, 0
    brick = BrickData(laws, {"median": None, "n": 0}, None, 0, {"stars": nothing, "galaxies": nothing}, nothing)
    galaxies, stars, *rest = evaluate("brick", brick, ValidateConfig(laws_max=0.1), "all")
    assert [gate["passed"] for gate in rest] == [None] * 5
    assert stars["name"] == "stars of the brick over the universe's laws, less 1" and stars["band"] == "all"
    assert stars["value"] == pytest.approx(0.4) and galaxies["value"] == pytest.approx(-0.05)
    assert stars["margin"] == pytest.approx(0.4 / (0.1 + SIGMAS_OF_MANY / 10)) and stars["error"] == pytest.approx(0.1)
    assert galaxies["error"] == pytest.approx(np.hypot(0.05, CLUSTERING)) and stars["n"] is None
    unknown = brick._replace(laws={"stars": (140, 100.0), "galaxies": (3, 0.0)})
    assert evaluate("brick", unknown, ValidateConfig(laws_max=0.1), "all") == [stars, *rest]


def test_which_true_objects_are_compared_and_with_what_magnitude():
    """By hand, one object a row, far apart: what takes it out, and the magnitude of those that stay."""
    n = 14
    frame = make_frame("r", 1, side=2)
    x, y = 100.0 + 200.0 * np.arange(n), np.full(n, 500.0)
    y[1] = 300.0
    x[0], x[1], y[2], y[3] = EDGE, EDGE + 0.5, 1000.0 - EDGE, 999.5 - EDGE
    word, electrons, mag, dmag = np.zeros(n, int), np.full(n, 1000.0), np.full(n, 21.0), np.zeros(n)
    word[4:7] = flags.OFF_CHIP, flags.STRONG_LENSING, flags.BAD_VALUE
    electrons[7], mag[8], dmag[9], dmag[10] = 0.0, np.nan, 0.3, -0.01
    trail, fraction, method = np.zeros(n), np.ones(n), np.full(n, "stamp", "U7")
    trail[11], fraction[12], fraction[13], method[13] = 3.0, 0.9, 0.5, "photons"
    none = np.zeros(n)
    truth = ObjectTable({
        "id": np.arange(n), "x": x, "y": y, "flags": word, "electrons": electrons, "mag_r": mag, "dmag": dmag,
        "trail_length": trail, "fraction": fraction, "method": method, "obj_type": np.ones(n, int),
        "size_disk": none + 0.74, "size_bulge": none, "bulge_frac": none,
    })  # fmt: skip
    info = frame.info | {"window": [0, 5000, 0, 1000], "zeropoint": 30.0}
    inside = truth_inside(replace(frame, truth=truth, measured=ObjectTable(dict(frame.measured), info), pixel=0.074))
    assert inside["id"].tolist() == [1, 3, 8, 9, 10, 13]
    assert inside["mag_r"] == pytest.approx([21.0, 21.0, 30.0 - 7.5, 21.3, 20.99, 21.0])
    assert inside["blended"].tolist() == [False, False, False, True, False, False]
    assert inside["half_light"] == pytest.approx(np.full(6, 0.74)) and inside["half_light_px"] == pytest.approx(10.0)


def test_the_light_around_an_object_is_that_of_its_neighbours():
    x, y = np.array([0.0, 11.0, 11.0, 50.0]), np.array([0.0, 0.0, 11.0, 0.0])
    assert crowd(x, y, np.array([1.0, 10.0, 100.0, 1e3])).tolist() == [10.0, 101.0, 10.0, 0.0]


def test_objects_of_several_frames_are_one_row_each():
    def seen(**columns):
        n = len(columns["id"])
        full = {"obj_type": np.ones(n, int), "half_light": np.zeros(n), "half_light_px": np.zeros(n)}
        return ObjectTable({name: np.asarray(values) for name, values in (full | columns).items()})

    one = seen(id=[7, 3], ra_epoch=[10.0, 359.999], dec_epoch=[5.0, 0.0], blended=[True, False], mag_r=[20.0, np.nan],
               mag_g=[np.nan, np.nan])  # fmt: skip
    two = seen(id=[3, 9, 7], ra_epoch=[0.003, 40.0, 10.0], dec_epoch=[0.002, -5.0, 5.0], blended=[False, False, False],
               mag_r=[22.0, 23.0, np.nan], mag_g=[np.nan, 24.0, 21.0])  # fmt: skip
    table = distinct([one, two], ["mag_r", "mag_g"])
    assert table["id"].tolist() == [3, 7, 9] and table["blended"].tolist() == [False, True, False]
    assert table["mag_r"] == pytest.approx([22.0, 20.0, 23.0])
    assert table["mag_g"] == pytest.approx([np.nan, 21.0, 24.0], nan_ok=True)
    assert table["ra_epoch"] == pytest.approx([0.001, 10.0, 40.0]) and table["dec_epoch"] == pytest.approx(
        [1e-3, 5, -5]
    )
    empty = distinct([], ["mag_r"])
    assert len(empty) == 0 and empty["blended"].dtype == bool and "mag_r" in empty


def test_numbers_of_a_bands_exposures_by_hand():
    """Trials of stars at S/N 4 to 600 and a galaxy: which of them each number is of."""
    snr = np.array([4.0, 5.5, 30.0, 51.0, 51.0, 60.0, 600.0, 40.0])
    n = len(snr)
    table = {name: np.full(n, np.nan) for name in trials(*empty_trials()).names}
    table |= {
        "galaxy": np.array([0] * 7 + [1]), "snr": snr, "mag": 30 - 2.5 * np.log10(snr),
        "found": np.array([1, 0, 1, 1, 1, 0, 1, 1]), "sound": np.array([1, 0, 1, 1, 0, 0, 1, 1]), "lonely": np.ones(n),
        "pull": np.array([9.0, 9, 1.0, 3.0, 9, 9, 9, 9]), "psf_size": np.array([9.0, 9, 9, 0.1, 9, 9, 9, 9]),
        "psf_e1": np.array([9.0, 9, 9, 0.2, 9, 9, 9, 9]), "psf_e2": np.array([9.0, 9, 9, 0.3, 9, 9, 9, 9]),
        "deferred_mas": np.arange(1.0, n + 1), "across_mas": -np.arange(1.0, n + 1), "light": np.full(n, 1.25),
    }  # fmt: skip
    infos = [
        {"zeropoint": z, "exptime": t, "depth_5sigma": d} for z, t, d in ((30, 1, 26.0), (33, 10, 25.0), (40, 1, 24.0))
    ]
    found = _exposure_statistics(ObjectTable(table), infos, ValidateConfig())
    assert (found["frames"], found["depth_5sigma"], found["zeropoint"]) == (3, 25.0, pytest.approx(30.5))
    assert found["point_sources"] == 5 and found["completeness"] == pytest.approx(3 / 5)
    assert found["completeness_curve"]["n"] == [0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 1, 3, 0]
    assert found["completeness_curve"]["found"] == [0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 2, 0]
    assert (found["pull"]["n"], found["pull"]["median"]) == (2, 2.0)
    assert [found["psf"][name]["median"] for name in ("psf_size", "psf_e1", "psf_e2")] == [0.1, 0.2, 0.3]
    part = {tuple(part["snr"]): part for part in found["transfer"]}
    assert (part[20, 50]["deferred_mas"]["median"], part[20, 50]["across_mas"]["median"]) == (3.0, -3.0)
    assert (part[50, 100]["deferred_mas"]["n"], part[50, 100]["light"]["median"]) == (1, pytest.approx(0.25))
    assert found["half_found"] == {"star": None, "galaxy": None} and part[5, 10]["light"]["n"] == 0


def empty_trials():
    frame = make_frame("g", 7, side=2)
    return truth_inside(frame), frame


def test_the_locus_is_of_bright_stars_and_positions_are_of_sharp_ones():
    """Colours of isolated stars of S/N above 20 in g, r and i; positions of those above 50 in one band, at least."""
    frames = [make_frame(band, 11) for band in "gri"]
    sources, _ = merge_brick(PIX, [frame.measured for frame in frames], BANDS)
    result, arrays = validate_brick(PIX, sources, frames, BANDS, ValidateConfig())
    locus = arrays["locus"]
    snr = np.array([sources[f"flux_{band}"] / sources[f"flux_err_{band}"] for band in "gri"])
    star = np.isin(np.arange(len(sources)), np.flatnonzero(sources["star"] > 0.5))
    assert locus["bands"] == ("g", "r", "i") and not locus["galaxy"].any()
    assert locus["input"].shape[1] == (star & (snr.min(axis=0) > 20)).sum() > 50
    assert result["radial_mas"]["n"] == (star & (snr.max(axis=0) > 50)).sum() > 50
    assert result["astrometry_mas"]["east"]["n"] > result["radial_mas"]["n"]
    assert result["frames"] == 3 and result["sources"] == len(sources)
