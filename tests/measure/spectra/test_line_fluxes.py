"""Fluxes of lines that were put into spectra rendered slab by slab with numpy: known, blended, absent, looked for."""

import numpy as np
import pytest
from measure.slitless import GaussianPsf, draw, frame_of, setting, sources_of, window_about

from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.calibration.bad_pixels import BAD, FULL
from csstsim.measure.spectra import line_fluxes
from csstsim.measure.spectra.chosen_orders import Choice
from csstsim.measure.spectra.extract import extract_spectra
from csstsim.measure.spectra.line_columns import BLENDED, BLIND, COLUMNS, LINES, PART
from csstsim.measure.spectra.line_fluxes import LineFluxes, compared_with_truth
from csstsim.measure.spectra.spectrum_columns import LOST, SATURATED

ERG = 1.986446e-12  # erg / cm2 of one photon / m2 at 1 angstrom
PLACE = (2000.3, 4000.27)
Z = 0.42  # [OII] at 5294, [NeIII] at 5495, Hd at 5826, Hg at 6165 angstrom
GIVEN = {"[OII]": 8.0, "[NeIII]": 3.0, "Hd": 0.0, "Hg": 0.6}  # photon / s / m2


def spectrum_of(given, z, level=0.02, sigma=1.0):
    """A smooth continuum with lines of given photons / s / m2, of `sigma` angstrom."""
    spectrum = level * 6000.0 / GRID
    for name, photons in given.items():
        for wavelength, fraction in LINES[name]:
            off = (GRID - wavelength * (1 + z)) / sigma
            spectrum = spectrum + fraction * photons * np.exp(-0.5 * off**2) / (sigma * np.sqrt(2 * np.pi))
    return spectrum


def rendered(camera, chip, spectrum):
    """(setting, expected image, sources) of one star."""
    window = window_about(*PLACE, 1, (0, 1300))
    s, image = setting(camera, chip, window, [PLACE]), np.zeros(window.shape)
    draw(image, window, s.gratings, s.orders, spectrum, np.flatnonzero(s.orders["order"] == 1)[0])
    return s, image, sources_of([spectrum])


def lines_of(scene, z, seed=None, marks=None):
    s, image, sources = scene
    lines = LineFluxes(np.array([z]))
    frame = frame_of(image, s.window, seed, marks=marks)
    extract_spectra(frame, s.orders, sources, s.model, GaussianPsf(), choice=Choice(snr_min=0.0), lines=lines)
    return lines.table()


@pytest.fixture(scope="module")
def emitter(camera):
    return rendered(camera, 2, spectrum_of(GIVEN, Z))


def test_without_noise_fluxes_are_those_put_in(emitter):
    table = lines_of(emitter, Z)
    assert set(GIVEN) <= set(table["line"].tolist())  # of 1 angstrom rms: half a per cent are beyond a narrow line
    for name, photons in GIVEN.items():
        [k] = np.flatnonzero(table["line"] == name)
        per = ERG / table["wavelength"][k]
        assert table["wavelength"][k] == pytest.approx(LINES[name][0][0] * (1 + Z))
        assert table["flux"][k] == pytest.approx(photons * per, rel=0.02, abs=0.03 * per)
        assert table["flux_true"][k] == pytest.approx(photons * per, rel=0.02, abs=0.03 * per)
        assert table["continuum"][k] == pytest.approx(0.02 * 6000 / table["wavelength"][k] * per, rel=0.05)


@pytest.mark.thorough
def test_pulls_of_isolated_lines_have_width_one(emitter):
    """120 frames, 480 lines of S/N 0 to 30, against the photons put in: the width within 15% (error 3%), mean 0.2."""
    pulls, limits = [], []
    for seed in range(120):
        table = lines_of(emitter, Z, seed)
        for name, photons in GIVEN.items():
            [k] = np.flatnonzero(table["line"] == name)
            assert not table["flags"][k] & BLENDED
            true = photons * ERG / table["wavelength"][k]
            pulls.append((table["flux"][k] - true) / table["flux_err"][k])
            assert np.isnan(table["limit"][k]) == (table["snr"][k] >= 3)
            if table["snr"][k] < 3:
                limits.append(true <= table["limit"][k])
    assert len(pulls) == 480
    assert np.std(pulls) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(pulls)) < 0.2
    assert len(limits) > 130 and np.mean(limits) > 0.985  # 3 sigma


def test_blended_lines_say_so_and_are_right_together(camera):
    """Ha and [NII] of a GI chip at z = 0.2, a resolution element apart."""
    given, z = {"Ha": 12.0, "[NII]": 6.0}, 0.2
    scene = rendered(camera, 1, spectrum_of(given, z))
    pulls = {name: [] for name in given}
    for seed in range(60):
        table = lines_of(scene, z, seed)
        for name, photons in given.items():
            [k] = np.flatnonzero(table["line"] == name)
            assert table["flags"][k] & BLENDED
            true = photons * ERG / table["wavelength"][k]
            pulls[name].append((table["flux"][k] - true) / table["flux_err"][k])
    for some in pulls.values():
        assert np.std(some) == pytest.approx(1.0, abs=5 / np.sqrt(120))
        assert abs(np.mean(some)) < 5 / np.sqrt(60)


@pytest.mark.thorough
def test_a_bright_line_is_found_without_a_redshift(camera, emitter):
    """Each time, within half a pixel; where there is none, noise makes one in fifty spectra at most."""
    none = rendered(camera, 2, spectrum_of({}, 0.0))
    pixel, false = 5.5, 0
    for seed in range(50):
        table = lines_of(emitter, np.nan, seed)
        assert (table["line"] == "").all() and (table["flags"] & BLIND > 0).all()
        assert abs(table["wavelength"] - LINES["[OII]"][0][0] * (1 + Z)).min() < pixel / 2
        assert (table["snr"] >= line_fluxes.SIGNIFICANCE_MIN).all() and len(table) <= line_fluxes.LINES_MAX
        false += len(lines_of(none, np.nan, seed))
    assert false <= 1


def test_a_line_of_the_list_is_not_found_twice(emitter):
    table = lines_of(emitter, Z, 3)
    assert (table["flags"] & BLIND == 0).all() and len(set(table["line"].tolist())) == len(table)


@pytest.mark.parametrize("z", [np.nan, 0.0, -0.1, 0.42, 30.0])
@pytest.mark.parametrize("mark", [BAD, FULL])
def test_a_spectrum_without_columns_has_no_lines(emitter, z, mark):
    _, image, _ = emitter
    marks = np.full(image.shape, mark)
    table = lines_of(emitter, z, 1, marks)
    assert len(table) == 0 and table.names == tuple(COLUMNS)
    assert compared_with_truth(table)["pull_width"] is None and compared_with_truth(table)["lines"] == 0
    if mark == BAD:
        marks[:, 600:615] = 0  # fewer columns than a line needs
        assert len(lines_of(emitter, z, 1, marks)) == 0


def test_lines_at_lost_columns_are_left_out_and_said(emitter):
    """A bad column on the line itself: no result; one next to it: a flag."""
    s, image, _ = emitter
    whole = lines_of(emitter, Z)
    [k] = np.flatnonzero(whole["line"] == "[OII]")
    position = round(float(whole["column"][k])) - s.window.x0
    for shift, kept in ((0, False), (2, True)):
        marks = np.zeros(image.shape, np.uint8)
        marks[:, position + shift] = BAD
        table = lines_of(emitter, Z, marks=marks)
        found = table["line"] == "[OII]"
        assert found.any() == kept
        if kept:
            assert table["flags"][found][0] & LOST
            assert table["flux"][found][0] == pytest.approx(whole["flux"][k], rel=0.03)


def test_the_fit_is_numpys_with_errors():
    rng = np.random.default_rng(2)
    matrix, error = rng.normal(size=(40, 4)) * [1.0, 1e3, 1e-4, 3.0], rng.uniform(0.5, 2.0, 40)
    data = rng.normal(size=(40, 2))
    values, errors = line_fluxes._fit(matrix, data, error)
    weighted = matrix / error[:, None]
    np.testing.assert_allclose(values, np.linalg.lstsq(weighted, data / error[:, None])[0], rtol=1e-9)
    scale = np.abs(weighted).max(axis=0)
    wanted = np.sqrt(np.diag(np.linalg.inv((weighted / scale).T @ (weighted / scale)))) / scale
    np.testing.assert_allclose(errors, wanted, rtol=1e-9)
    matrix[:, 0] = 0.0  # a line without light there
    assert np.isfinite(line_fluxes._fit(matrix, data, error)[0]).all()


def test_the_table_is_judged_by_its_isolated_lines(emitter):
    tables = [lines_of(emitter, Z, seed) for seed in range(5)]
    table = type(tables[0])({name: np.concatenate([t[name] for t in tables]) for name in COLUMNS})
    figures = compared_with_truth(table)
    isolated = table["flags"] == 0
    pull = ((table["flux"] - table["flux_true"]) / table["flux_err"])[isolated].astype(float)
    assert figures["isolated"] == isolated.sum() and figures["lines"] == len(table)
    assert figures["pull_width"] == pytest.approx(pull.std(ddof=1), rel=1e-4)
    assert figures["limits"] == np.isfinite(table["limit"]).sum() >= figures["limits_held"]


def test_judgement_of_a_table_by_hand():
    """Two isolated lines of pulls 1 and -3, a flagged one, one without a true flux, two limits of which one holds."""
    values = {
        "flux": [5.0, 2.0, 2.0, 1.0], "flux_err": [2.0, 1.0, 1.0, 1.0], "flux_true": [3.0, 5.0, 4.0, np.nan],
        "snr": [2.5, 3.0, 90.0, 1.0], "limit": [11.0, np.nan, 3.0, 4.0], "flags": [0, 0, BLENDED, 0],
    }  # fmt: skip
    zero = {name: np.zeros(4, dtype) for name, (dtype, _) in COLUMNS.items()}
    table = ObjectTable(zero | {name: np.array(v, COLUMNS[name][0]) for name, v in values.items()})
    assert compared_with_truth(table) == {
        "lines": 4, "detected": 2, "isolated": 2, "pull_mean": -1.0, "pull_width": pytest.approx(8**0.5),
        "limits": 2, "limits_held": 1,
    }  # fmt: skip
    one = compared_with_truth(table.take([1]))
    assert one["isolated"] == 1 and one["pull_mean"] is None and one["pull_width"] is None


def test_lines_say_whose_they_are_and_where(camera, emitter):
    s, _, _ = emitter
    table = lines_of(emitter, Z)
    [one] = np.flatnonzero(s.orders["order"] == 1)
    wanted = s.orders["x"][one] + s.orders["p"][one] + s.orders["q"][one] * table["wavelength"]
    assert table["column"] == pytest.approx(wanted)
    assert (
        set(table["id"].tolist()) == {100} and set(table["row"].tolist()) == {0} and set(table["order"].tolist()) == {1}
    )
    assert table["snr"] == pytest.approx(table["flux"] / table["flux_err"])


@pytest.mark.parametrize(("first", "kept", "part"), [(1, True, True), (3, True, False), (-1, False, None)])
def test_a_line_with_a_part_of_its_light(emitter, first, kept, part):
    """Its columns from `first` on are lost: between a half and 0.8 of it flagged, less left out; fluxes hold."""
    s, image, _ = emitter
    whole = lines_of(emitter, Z)
    [k] = np.flatnonzero(whole["line"] == "[OII]")
    position = round(float(whole["column"][k])) - s.window.x0
    marks = np.zeros(image.shape, np.uint8)
    marks[:, position + first : position + 9] = BAD
    marks[:, position] = 0
    table = lines_of(emitter, Z, marks=marks)
    found = table["line"] == "[OII]"
    assert found.any() == kept
    if kept:
        assert bool(table["flags"][found][0] & PART) == part
        assert table["flux"][found][0] == pytest.approx(whole["flux"][k], rel=0.05)


def test_the_top_of_a_parabola_through_three_points():
    spectrum = line_fluxes._Spectrum.__new__(line_fluxes._Spectrum)
    spectrum.column = np.arange(100.0, 105.0)
    signal = 9.0 - 2.0 * (np.arange(5.0) - 2.3) ** 2
    assert spectrum._peak(signal, 2) == pytest.approx(102.3)
    assert spectrum._peak(signal, 4) == 104.0 and spectrum._peak(signal, 0) == 100.0
    assert spectrum._peak(np.full(5, 7.0), 2) == 102.0  # no bend
    assert spectrum._peak(np.array([0.0, 1.0, 2.0, 4.0, 0.0]), 2) == 102.0  # bent upwards
    assert spectrum._peak(np.array([0.0, 0.0, 5.0, 5.0 + 1e-9, 0.0]), 2) == pytest.approx(102.5)


def test_columns_near_a_line_are_within_one_and_a_half_widths_of_a_part():
    line = line_fluxes.Line("", np.array([10.0, 14.0]), 5000.0, np.zeros(3), np.zeros(3), 2.0)
    assert line.near(np.array([6.9, 7.1, 12.0, 16.9, 17.1])).tolist() == [False, True, True, True, False]


def test_at_most_three_lines_are_found_the_highest_first(monkeypatch):
    """Peaks of 9, 30, 7, 20 and 40: one in a line of the list, one on a column next to a saturated one, 20 px about."""
    spectrum = line_fluxes._Spectrum.__new__(line_fluxes._Spectrum)
    spectrum.column, spectrum.good = np.arange(1000.0, 1400.0), np.ones(400, bool)
    spectrum.column_0, spectrum.column_slope = 1000.0, 0.5
    signal = np.zeros(400)
    signal[[60, 81, 120, 160, 200, 230, 270, 300]] = 9.0, 8.0, 30.0, 7.0, 20.0, 40.0, 50.0, 4.9
    signal[[105, 135]] = 29.0  # next to the second
    signal[[19, 380]] = 99.0  # no continuum on either side
    monkeypatch.setattr(spectrum, "_significance", lambda usable: signal.copy(), raising=False)
    monkeypatch.setattr(spectrum, "_line", lambda name, parts, flags: (name, parts, flags), raising=False)
    monkeypatch.setattr(spectrum, "_flags", lambda line: SATURATED if line[1][0][0] == 460.0 else 0, raising=False)
    known = line_fluxes.Line("Ha", np.array([1269.0]), 538.0, np.zeros(3), np.zeros(3), 2.0)
    wanted = [("", [(2.0 * k, 1.0)], BLIND) for k in (120, 200, 60)]
    assert spectrum.search([known]) == wanted
    spectrum.good[40:] = False
    assert spectrum.search([known]) == []
