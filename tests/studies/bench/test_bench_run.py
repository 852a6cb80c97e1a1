"""A run of the benchmark on parts that are given: how many objects of what size, how long, and where results go."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from csstsim.base.errors import InputError
from csstsim.studies.bench import chart as charts
from csstsim.studies.bench import command
from csstsim.studies.bench.chart import ON_NODES, OURS, PEERS, PRESET, Point


@pytest.fixture
def asked(monkeypatch):
    """What `bench` asks of its parts."""
    asked = SimpleNamespace(disperser=None)
    setting = lambda folder, band: SimpleNamespace(chip=SimpleNamespace(id=9), disperser=asked.disperser)  # noqa: E731
    monkeypatch.setattr(command, "make_setting", setting)

    def kind(name):
        def make(setting, count, seed, largest):
            asked.cases = name, count, seed, largest
            return "cases"

        return SimpleNamespace(
            methods=(SimpleNamespace(name="photons"), SimpleNamespace(name="stamps")), make_cases=make
        )

    monkeypatch.setattr("csstsim.studies.bench.imaging.benchmark.IMAGING", kind("imaging"))
    monkeypatch.setattr("csstsim.studies.bench.imaging.benchmark.SHAPES", kind("shapes"))
    monkeypatch.setattr("csstsim.studies.bench.slitless.benchmark.SLITLESS", kind("slitless"))

    def sweep(kind, setting, cases, methods, **how):
        asked.how, asked.methods = how, [method.name for method in methods]
        return ["row"]

    monkeypatch.setattr(command, "sweep", sweep)
    monkeypatch.setattr(command, "summarise", lambda rows, kind, band: [rows, band])
    monkeypatch.setattr(command, "text", lambda lines, kind: ["a line"])
    asked.written, asked.said = {}, []
    monkeypatch.setattr(command, "write", lambda path, rows: asked.written.update({path.name: rows}))
    monkeypatch.setattr(command, "draw_chart", lambda path, tables: asked.written.update({path.name: tables}))
    return asked


@pytest.mark.parametrize(
    ("band", "shapes", "quick", "objects", "cases"),
    [("r", False, False, None, ("imaging", 320, 7, 5.0)), ("r", False, True, None, ("imaging", 24, 7, 0.5)),
     ("g", True, False, None, ("shapes", 48, 7, 5.0)), ("GV", False, False, None, ("slitless", 24, 7, 5.0)),
     ("r", False, True, 6, ("imaging", 6, 7, 0.5))],
)  # fmt: skip
def test_a_run_has_its_objects_and_its_time(tmp_path, asked, band, shapes, quick, objects, cases):
    asked.disperser = "disperser" if band == "GV" else None
    command.bench(tmp_path, band, "stamps", quick, objects, 7, asked.said.append, shapes)
    assert asked.cases == cases and asked.methods == ["stamps"]
    assert asked.how == ({"seconds": 0.01, "electrons": 1e6} if quick else {"seconds": 0.2, "electrons": 3e7})
    lines = [["row"], band]
    assert asked.written == {"cases.csv": ["row"], "speed_accuracy.csv": lines, "speed_accuracy.png": [lines]}
    assert asked.said[1] == "a line" and "chip 9" in asked.said[0]


def test_shapes_are_of_images_alone(tmp_path, asked):
    with pytest.raises(InputError, match=r"--shapes: is for imaging filters .*'GI'"):
        command.bench(tmp_path, "GI", None, True, None, 1, print, True)


def test_a_panel_marks_presets_peers_and_limits():
    """The front, of rising cost, is filled and joined; others are open."""
    axis = Figure().subplots()
    found = {
        "photons": Point(1.0, 0.5, 0.9, True), "standard": Point(2.0, 0.1, 0.4, False),
        "UFig": Point(3.0, 0.3, 0.6, False), "stamps": Point(4.0, 0.05, 0.2, False),
    }  # fmt: skip
    charts._panel(axis, found)
    joined = axis.lines[0].get_xydata().tolist()
    assert joined == [[1.0, 0.5], [2.0, 0.1], [4.0, 0.05]]
    dots = axis.collections
    assert [tuple(dot.get_offsets()[0]) for dot in dots] == [(p.cost, p.error) for p in found.values()]
    from matplotlib.colors import to_hex

    assert [to_hex(dot.get_edgecolor()[0]) for dot in dots] == [OURS, PRESET, PEERS, OURS]
    assert [to_hex(dot.get_facecolor()[0]) == "#ffffff" for dot in dots] == [False, False, True, False]
    bars = [line.get_xydata().tolist() for line in axis.lines[1:]]
    assert bars == [[[p.cost, p.error], [p.cost, p.high]] for p in found.values()]


def test_charts_of_two_filters_stand_side_by_side(monkeypatch, tmp_path):
    """A row a kind, with the number of its objects on nodes; all have a common axis of cost."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **how: figures.append(self) or path.write_bytes(b""))
    monkeypatch.setattr(charts, "_label", lambda axis, found: None)
    monkeypatch.setattr(Figure, "draw_without_rendering", lambda self: None)
    line = {"method": "photons", "limit": False, "against": ON_NODES, "visible_95": 2.0}
    tables = [
        [line | {"filter": "r", "kind": "galaxy", "objects": 5.0, "cpu_us": 8e3, "visible_median": 0.3},
         line | {"filter": "r", "kind": "star", "objects": 4.0, "cpu_us": 1e3, "visible_median": 0.06}],
        [line | {"filter": "GI", "kind": "star", "objects": 9.0, "cpu_us": 1e5, "visible_median": 1.5}],
    ]  # fmt: skip
    charts.draw_chart(tmp_path / "a.png", tables)
    assert [axis.get_title() for axis in figures[0].axes] == [
        "stars, r (4 objects)", "stars, GI (9 objects)", "galaxies, r (5 objects)", "galaxies, GI (0 objects)",
    ]  # fmt: skip
    stars, _, galaxies, _ = figures[0].axes
    assert stars.get_xlim() == pytest.approx((1e-3 / 8, 0.1 * 30))
    assert np.allclose([stars.get_ylim(), galaxies.get_ylim()], [(0.02, 6.0), (0.03, 6.0)])
