"""`csstsim bench` on a tiny set: tables and chart are written; bad input is refused in one line."""

import csv

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure

from csstsim.base.errors import InputError
from csstsim.command_line.main import main
from csstsim.studies.bench.chart import ON_NODES, Point, draw_chart, pareto, points
from csstsim.studies.bench.command import chart, choose_methods
from csstsim.studies.bench.imaging.measures import NAMES
from csstsim.studies.bench.imaging.methods import METHODS


def run(*options):
    return CliRunner().invoke(main, ["bench", *options])


@pytest.fixture(scope="module")
def folder(bench_folder):
    result = run("--quick", "--objects", "4", "--methods", "photons,stamps", "--output", str(bench_folder))
    assert result.exit_code == 0, result.output
    return bench_folder


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_every_object_and_method_has_a_row(folder):
    rows = read(folder / "cases.csv")
    assert sorted((row["method"], row["object"]) for row in rows) == [
        (method, str(i)) for method in ("photons", "stamps") for i in range(4)
    ]
    assert all(float(row["cpu_s"]) > 0 for row in rows)
    assert {f"{name}_{which}" for name in NAMES for which in ("standard", "direct", "chance")} <= set(rows[0])


def test_methods_draw_what_direct_optics_say(folder):
    """At a node: 5 of their statistical errors, or the accuracy goals where nothing is random."""
    for row in read(folder / "cases.csv"):
        if row["at_node"] == "True":
            for name, goal in (("x_mas", 1.0), ("y_mas", 1.0), ("size2", 1e-3), ("e1", 1e-3), ("e2", 1e-3)):
                assert abs(float(row[f"{name}_direct"])) < goal + 5 * float(row[f"{name}_chance"]), (row, name)


def test_summary_and_chart_are_written(folder):
    assert {row["against"] for row in read(folder / "speed_accuracy.csv")} >= {"reference", "direct optics, on nodes"}
    assert (folder / "speed_accuracy.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--methods", "photons,abacus"), "abacus"),
        (("--filter", "w"), "--filter"),
        (("--chart", "absent.csv"), "absent.csv"),
        (("--chart", "absent.csv", "--quick"), "--chart"),
        (("--objects", "0"), "--objects"),
        (("--objects", "two"), "--objects"),
    ],
)
def test_bad_options_are_refused(bench_folder, options, named):
    result = run("--output", str(bench_folder), *options)
    assert result.exit_code == 2
    assert named in result.output
    assert "Traceback" not in result.output


def test_front_holds_what_nothing_beats():
    found = {
        "slow": Point(3.0, 0.1, 9.0, False),
        "fast": Point(1.0, 1.0, 1.0, False),
        "worse": Point(2.0, 2.0, 2.0, False),
        "even": Point(4.0, 0.1, 0.1, False),
    }
    assert pareto(found) == ["fast", "slow"]


def test_the_chart_shows_medians_and_95th_percentiles(monkeypatch, tmp_path):
    """A bar of each method from one to the other, within the panel."""
    line = {"filter": "r", "kind": "star", "against": ON_NODES, "objects": 9, "limit": False}
    lines = [
        line | {"method": "photons", "cpu_us": 1e3, "visible_median": 0.02, "visible_95": 0.45},
        line | {"method": "stamps", "cpu_us": 1e4, "visible_median": 0.01, "visible_95": 41.0},
    ]
    assert points(lines, "star")["stamps"] == Point(pytest.approx(0.01), 0.01, 41.0, False)
    figures = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *args, **how: (figures.append(self), save(self, *args, **how)))
    draw_chart(tmp_path / "chart.png", [lines])
    axis = figures[0].axes[0]
    bars = [np.array(drawn.get_data()).T.tolist() for drawn in axis.lines]
    assert [[1e-3, 0.02], [1e-3, 0.45]] in [pytest.approx(np.array(bar)) for bar in bars if len(bar) == 2]
    assert [[1e-2, 0.01], [1e-2, 41.0]] in [pytest.approx(np.array(bar)) for bar in bars if len(bar) == 2]
    assert axis.get_ylim()[1] > 41.0


@pytest.mark.slow
def test_other_shapes_are_drawn_as_direct_optics_say(bench_folder, tmp_path):
    """A galaxy of each kind; GalSim's FFT of them is the same light (its PSF is the nearest node's, not blended)."""
    for path in bench_folder.glob("psf_r_*"):
        (tmp_path / path.name).symlink_to(path)
    result = run("--quick", "--shapes", "--objects", "3", "--methods", "stamps,GalSim FFT", "--output", str(tmp_path))
    assert result.exit_code == 0, result.output
    rows = read(tmp_path / "cases.csv")
    assert sorted({row["kind"] for row in rows}) == ["free n", "image", "knots"] and len(rows) == 6
    for row in rows:
        near = 3.0 if row["method"] == "GalSim FFT" else 1.0
        for name, goal in (("flux", 1e-3), ("x_mas", 1.0), ("y_mas", 1.0), ("size2", 1e-3), ("e1", 1e-3)):
            assert abs(float(row[f"{name}_direct"])) < near * goal, (row, name)
    assert (tmp_path / "speed_accuracy.png").read_bytes().startswith(b"\x89PNG")
    assert run("--shapes", "--filter", "GV", "--output", str(tmp_path)).exit_code == 2


def test_methods_are_chosen_by_how_their_names_begin():
    names = [method.name for method in METHODS]
    assert choose_methods(None, METHODS) is METHODS and choose_methods("", METHODS) is METHODS
    assert [m.name for m in choose_methods("stamps, GALSIM f, photons", METHODS)] == ["stamps", "GalSim FFT", "photons"]
    of_galsim = [name for name in names if name.startswith("GalSim")]
    assert [method.name for method in choose_methods("galsim,GalSim FFT", METHODS)] == of_galsim
    for wrong in ("photons,", "hotons"):
        with pytest.raises(InputError, match=r'--methods: unknown method .*"reference", "photons"'):
            choose_methods(wrong, METHODS)


def test_a_table_of_another_kind_is_no_chart(tmp_path):
    """One of the columns is missing, or a word."""
    good = {"filter": "r", "cpu_us": 3.0, "visible_median": 0.1, "limit": True}
    for number, change in enumerate(({"filter": None}, {"cpu_us": "much"}, {"limit": None}, {"visible_median": None})):
        columns = {name: value for name, value in (good | change).items() if value is not None}
        path = tmp_path / f"{number}.csv"
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerow(columns)
        with pytest.raises(InputError, match=rf"{number}\.csv: is not a table of csstsim bench"):
            chart(tmp_path, [path], print)
