"""`csstsim bench` with a grating: a quick run, direct optics against the reference, measures of known errors."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from support.commands import done, refused

from csstsim.base.rng import stream
from csstsim.studies.bench import setting as bench_setting
from csstsim.studies.bench.chart import ON_NODES
from csstsim.studies.bench.imaging.cases import Position
from csstsim.studies.bench.imaging.measures import EDGE_PX
from csstsim.studies.bench.slitless import cases as spectrum_cases
from csstsim.studies.bench.slitless import truth as spectrum_truth
from csstsim.studies.bench.slitless.benchmark import SLITLESS
from csstsim.studies.bench.slitless.cases import SPECTRA, make_spectrum_case, make_spectrum_cases
from csstsim.studies.bench.slitless.measures import NAMES, _width2, derivative, errors
from csstsim.studies.bench.slitless.methods import slabs

METHODS = "photons,slabs 4"
FLUX, ACROSS_PX, SIZE2 = 1e-3, 1e-3, 2e-3  # direct optics against the reference


@pytest.fixture(scope="module", autouse=True)
def small():
    """Few nodes, small objects, low windows, direct optics at eight wavelengths."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench_setting, "GRID", 3)
        patch.setattr(spectrum_cases, "HALF_MAX", 36)
        patch.setattr(spectrum_cases, "LARGEST", 0.15)
        patch.setattr(spectrum_truth, "NODES", 8)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory, small):
    folder = tmp_path_factory.mktemp("bench_GV")
    how = ("--filter", "GV", "--quick", "--objects", "2", "--methods", METHODS, "--output", str(folder))
    done("bench", *how)
    return folder


@pytest.fixture(scope="module")
def setting(folder):
    return bench_setting.make_setting(folder, "GV")


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.thorough
def test_every_object_and_method_has_a_row(folder):
    rows = read(folder / "cases.csv")
    assert sorted((row["method"], row["object"]) for row in rows) == sorted(
        (method, str(i)) for method in METHODS.split(",") for i in range(2)
    )
    assert {f"{name}_{which}" for name in NAMES for which in ("standard", "direct", "chance")} <= set(rows[0])
    assert all(float(row["cpu_s"]) > 0 and row["spectrum"] in SPECTRA for row in rows)


def test_methods_draw_what_direct_optics_say(folder):
    """5 of their statistical errors, or flux 1e-3, 0.01 px across and 2% of the width where nothing is random."""
    for row in read(folder / "cases.csv"):
        if row["at_node"] == "True":
            for name, goal in (("flux", 2 * FLUX), ("across_px", 0.01), ("size2", 0.02)):
                assert abs(float(row[f"{name}_direct"])) < goal + 5 * float(row[f"{name}_chance"]), (row, name)


def test_tables_of_two_filters_make_one_chart(folder):
    lines = read(folder / "speed_accuracy.csv")
    assert {line["filter"] for line in lines} == {"GV"} and ON_NODES in {line["against"] for line in lines}
    other = folder / "other.csv"
    other.write_text((folder / "speed_accuracy.csv").read_text().replace("GV,", "GU,"))
    tables = [option for path in (folder / "speed_accuracy.csv", other) for option in ("--chart", str(path))]
    done("bench", *tables, "--output", folder / "both")
    assert (folder / "both" / "speed_accuracy.png").read_bytes().startswith(b"\x89PNG")
    assert "cases.csv" in refused("bench", "--chart", folder / "cases.csv")


def test_the_sample_is_what_it_says(setting):
    for case in make_spectrum_cases(setting, 8):
        rates = setting.disperser.rates[case.visits[0, 1], setting.disperser.orders.index(1)]
        assert case.binned_density @ rates == pytest.approx(case.electrons, rel=1e-9)
        assert case.scene.electrons.sum() == pytest.approx(case.electrons, rel=1e-6)
        assert case.brighter(7.0).binned_density @ rates == pytest.approx(7.0, rel=1e-9)


def test_each_spectrum_is_on_nodes_and_between_them(setting):
    made = make_spectrum_cases(setting, 2 * len(SPECTRA))
    assert {(case.spectrum, case.at_node) for case in made} == {(name, on) for name in SPECTRA for on in (True, False)}


@pytest.fixture(scope="module")
def lines(setting):
    case = make_spectrum_case(setting, stream(3, "test"), 0, 1e5, size=0.2, spectrum="lines")
    return case, SLITLESS.truth(setting)(case)


def test_direct_optics_and_the_reference_agree(setting, lines):
    case, direct = lines
    reference = SLITLESS.standard(setting, case) / case.electrons
    got = dict(zip(NAMES, errors(setting, case, reference, direct, np.inf)[0], strict=True))
    assert abs(got["flux"]) < FLUX and abs(got["across_px"]) < ACROSS_PX and abs(got["size2"]) < SIZE2
    assert abs(got["line_px"]) < 0.005
    # A line of 2 angstrom in bins of w = 0.21 px, even in each, is wider by w^2 / 6
    assert got["line_width2"] == pytest.approx(0.212**2 / 6, rel=0.4)


def test_measures_find_known_errors(setting, lines):
    case, truth = lines
    along, across = derivative(truth, 1), derivative(truth, 0)
    wrong = 1.002 * truth - 0.01 * along + 0.02 * across
    got = dict(zip(NAMES, errors(setting, case, wrong, truth, np.inf)[0], strict=True))
    assert got["flux"] == pytest.approx(2e-3, rel=1e-2)
    assert got["along_px"] == pytest.approx(0.01, abs=1e-3) and got["line_px"] == pytest.approx(0.01, abs=1e-3)
    assert got["across_px"] == pytest.approx(-0.02, abs=1e-3)
    wider = truth + 0.5 * 0.03 * derivative(along, 1)
    got = dict(zip(NAMES, errors(setting, case, wider, truth, np.inf)[0], strict=True))
    assert got["line_width2"] == pytest.approx(0.03, rel=1e-6) and abs(got["flux"]) < 1e-6


def test_an_error_counts_but_at_the_edge_of_the_psfs_box(setting, lines):
    """The same pixel too bright, by row: all rows are evaluated but those within EDGE_PX of the box's edge."""
    case, truth = lines
    box, middle = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling, (len(truth) - 1) / 2
    for row in range(len(truth)):
        wrong = truth.copy()
        wrong[row, truth.shape[1] // 2] += 1e-3
        got = dict(zip(NAMES, errors(setting, case, wrong, truth, np.inf)[0], strict=True))
        assert (got["pixel"] > 0) == (abs(abs(row - middle) - box) > EDGE_PX), row


def test_the_preset_draws_a_faint_object_as_photons_do(setting):
    """It takes bins of a pixel: 2000 of 5 electrons have as many as bins of a quarter have, within 5 sigma."""
    case = make_spectrum_case(setting, stream(4, "test"), 0, 5.0, size=0.1)
    methods = [method for method in SLITLESS.methods if method.name in ("photons", "standard")]
    drawn = {method.name: method.prepare(setting, case)(2000).sum() for method in methods}
    assert abs(drawn["standard"] - drawn["photons"]) < 5 * np.sqrt(2 * drawn["photons"])
    assert drawn["photons"] == pytest.approx(1e4, rel=0.1)


def test_chance_is_the_scatter_of_random_electrons(setting, lines):
    """Of 100 images of 20,000 electrons: standard deviations within 35% (5 of their own) of the chance stated."""
    case, truth = lines
    rng, number = np.random.default_rng(3), 20_000
    mean = number * np.maximum(truth, 0)
    some = [errors(setting, case, rng.poisson(mean) / number, truth, number) for _ in range(100)]
    scatter, chance = np.std([value for value, _ in some], axis=0), np.mean([c for _, c in some], axis=0)
    assert scatter[:6] == pytest.approx(chance[:6], rel=0.35)


def test_a_spectrum_without_lines_has_no_line(setting):
    truth = np.outer(np.exp(-0.5 * np.linspace(-8, 8, 97) ** 2), np.ones(200))
    case = SimpleNamespace(electrons=1e4, lines=np.empty(0))
    got, _ = errors(setting, case, truth, truth, np.inf)
    assert np.isnan(got[[4, 5]]).all() and (got[[0, 1, 2, 3]] == 0).all()


def test_slabs_are_as_many_to_a_pixel_as_their_method_says(setting):
    """A star of three lines: each finer method is three times nearer to 32 slabs a pixel; light is the same in all."""
    case = make_spectrum_case(setting, stream(5, "test"), 0, 1e5, spectrum="lines")
    drawn = {m.name: m.prepare(setting, case)(1) for m in SLITLESS.methods if m.name.startswith("slabs")}
    assert list(drawn) == [f"slabs {k}" for k in (1, 2, 4, 8)]
    fine = slabs(32)(setting, case)(1)
    off = np.array([np.abs(image - fine).sum() / fine.sum() for image in drawn.values()])
    assert off[0] > 0.01 and (off[1:] < off[:-1] / 3).all()
    assert [image.sum() for image in drawn.values()] == pytest.approx([fine.sum()] * 4, rel=1e-4)


def test_presets_of_spectra_are_those_they_are_called(setting):
    """Without noise, light is expected, not counted."""
    case = make_spectrum_case(setting, stream(4, "test"), 0, 5.0, size=0.1)
    methods = {method.name: method for method in SLITLESS.methods}
    kinds = {name: methods[name].prepare(setting, case)(3).dtype.kind for name in ("photons", "standard", "noise_free")}
    assert kinds == {"photons": "i", "standard": "i", "noise_free": "f"}
    assert [name for name, method in methods.items() if method.preset] == ["standard", "noise_free"]


@pytest.mark.parametrize("spectrum", ["flat", "lines"])
def test_the_papers_method_lays_the_same_light_along_the_same_trace(setting, spectrum):
    """Beside a node, against the reference: light to 0.1%, the trace to 0.01 px, the width to 2% in each of its parts.

    The part of a sub-band with the PSF of the next one would be 5% wider, or narrower.
    """
    case = make_spectrum_case(setting, stream(5, "test"), 0, 1e5, spectrum=spectrum)
    wanted = SLITLESS.standard(setting, case) / case.electrons
    [paper] = [method for method in SLITLESS.methods if method.name == "as the paper"]
    image = paper.prepare(setting, case)(2) / (2 * case.electrons)
    assert image.shape == wanted.shape and image.sum() == pytest.approx(wanted.sum(), rel=1e-3)
    off = dict(zip(NAMES, errors(setting, case, image, wanted, np.inf)[0], strict=True))
    assert abs(off["across_px"]) < 0.01 > abs(off["along_px"])
    for columns in np.array_split(np.arange(image.shape[1]), 4):
        if wanted[:, columns].sum() > 0.01:
            assert image[:, columns].sum() == pytest.approx(wanted[:, columns].sum(), rel=0.01)
            assert _width2(image[:, columns]) == pytest.approx(_width2(wanted[:, columns]), rel=0.02)


def test_a_case_has_the_light_of_its_spectrum_in_each_sub_band(setting):
    """As the PSF's wavelengths weight the first order."""
    disperser = setting.disperser
    for case in make_spectrum_cases(setting, 8, seed=3):
        first = case.binned_density * disperser.rates[case.visits[0, 1], disperser.orders.index(1)]
        of_bands = case.scene.electrons.sum(axis=0)
        assert of_bands == pytest.approx(disperser.psf_weights @ first, rel=1e-5)
        assert case.visits[0, 1] == (case.row["x"][0] > disperser.gratings.split)


def test_no_object_lies_near_the_line_between_the_gratings(setting, monkeypatch):
    """A position within 400 px of it is drawn again."""
    split = setting.disperser.gratings.split
    at = iter([split + 10.0, split - 399.0, split + 401.0])
    monkeypatch.setattr(spectrum_cases, "position", lambda *given: Position(next(at), 4000.0))
    case = make_spectrum_case(setting, stream(3, "test"), 1, 1e4)
    assert case.row["x"][0] == pytest.approx(split + 401) and case.visits[0, 1] == 1
