"""What `csstsim plan` says, of a campaign made up here: counts, bytes, tables, words; numbers worked out by hand."""

import io
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from csstsim.base.healpix import NSIDE, pixel_centre
from csstsim.campaign import plan, sky_ranges
from csstsim.campaign.costs import Cost

WHOLE, PART = SimpleNamespace(nx=1000, ny=2000), SimpleNamespace(nx=3000, ny=500)
COSTS = {
    "truth": {7: Cost(40.0, 700.0), 8: Cost(5.0, 800.0)}, "psf": {9: Cost(30.0, 1.0), 21: Cost(20.0, 1.0)},
    "render": {"a": Cost(2.0, 1500.0), "b": Cost(4.0, 1234.6)}, "measure": {"a": Cost(7.0, 10.0)},
    "extract": {"b": Cost(11.0, 10.0)}, "chip": {"a": Cost(1e4, 1.0)}, "report": {None: Cost(3000.0, 1.0)},
}  # fmt: skip


def job(obsid, number, kind, window):
    return SimpleNamespace(obsid=obsid, key=(obsid, number), chip=SimpleNamespace(id=number, kind=kind), window=window)


JOBS = job("1", 9, "imaging", WHOLE), job("1", 21, "slitless", PART), job("2", 9, "imaging", WHOLE)


def opened(share=None, embedded=True, files=()):
    """Return what plan reads of an OpenCampaign of two imaging frames and a slitless one."""
    detector = SimpleNamespace(channels=16, channel_nx=100, channel_ny=200, prescan=7, overscan=11, parallel_overscan=3)
    return SimpleNamespace(
        jobs=JOBS, imaging_jobs=(JOBS[0], JOBS[2]), slitless_jobs=(JOBS[1],), merge_bricks={7: [], 8: [], 9: []},
        config=SimpleNamespace(psf=SimpleNamespace(grid=3), share=share), camera=SimpleNamespace(detector=detector),
        embedded=embedded, sky_bricks=[7, 8], sky_chips=[9, 21], in_share=lambda path: files[path],
        paths=SimpleNamespace(truth=lambda pix: pix, psf=lambda chip: chip),
    )  # fmt: skip


@pytest.fixture
def planned(monkeypatch):
    """Return a function that plans a made-up campaign, with costs, objects and kept light of this file."""

    def run(kept=(), **given):
        monkeypatch.setattr(plan, "expected", lambda run: COSTS)
        monkeypatch.setattr(plan, "expected_objects", lambda run, jobs: {one.key: 12_345.0 for one in jobs})
        monkeypatch.setattr(plan, "_covered", lambda run: [8])
        monkeypatch.setattr(plan, "kinds", lambda run: {"render": SimpleNamespace(made_for=kept)})
        return plan.plan(opened(**given))

    return run


def test_the_plan_counts_what_is_made(planned):
    counts, disk, costs = planned()
    assert counts == {
        "exposures": 2, "chips": 2, "Level-0 files": 3, "megapixels": 5.5, "objects rendered, estimated": 37_000,
        "truth bricks": "2: 7, 8", "bricks touched": 3, "bricks fully covered": 1, "jobs": 9,
    }  # fmt: skip
    # 16 channels of 118 x 203 px of two bytes; 2 sets of 9 nodes at 4 wavelengths, of three tables of float32
    assert disk == {
        "Level-0": 3 * 2 * 16 * 118 * 203, "PSF tables": 2 * 9 * 4 * (2 * 256**2 + 64**2) * 4,
        "largest intermediates (a job)": 8 * 2_000_000,
    }  # fmt: skip
    assert costs is COSTS


def test_light_that_is_kept_is_counted_by_pixel(planned):
    """5 bytes of a pixel of an image, 8 of a slitless one."""
    assert planned(kept=JOBS[:2])[1]["light kept"] == 5 * 2_000_000 + 8 * 1_500_000


def test_products_in_the_shared_folder_are_counted(planned, tmp_path):
    files = {number: tmp_path / str(number) for number in (7, 8, 9, 21)}
    for number in (8, 9, 21):
        files[number].touch()
    assert planned(share=tmp_path, files=files)[0]["truth bricks, PSF sets shared"] == 3


def test_objects_of_a_catalogue_of_ones_own_are_as_many_as_it_has(planned):
    assert planned(embedded=False)[0]["objects rendered, estimated"] == "all in the catalogue"


def test_few_bricks_are_listed_and_many_counted():
    assert plan._listed({30: 1, 7: 1}) == "2: 7, 30" and plan._listed(()) == 0
    assert plan._listed(range(8)) == "8: 0, 1, 2, 3, 4, 5, 6, 7" and plan._listed(range(9)) == 9


def test_a_brick_is_covered_if_every_point_of_it_is(monkeypatch):
    """Two windows that share the brick at a declination; without the second, or a strip between, it is not covered."""
    monkeypatch.setattr(plan, "apparent", lambda ra, dec, observer: (ra, dec))
    pix = 400_123
    _, dec = pixel_centre(NSIDE * 32, np.arange(pix * 1024, (pix + 1) * 1024))
    middle = float(np.median(dec))

    def above(low, high):
        window = SimpleNamespace(contains=lambda x, y: (y >= low) & (y < high))
        return SimpleNamespace(
            wcs=SimpleNamespace(world_to_pixel=lambda ra, dec: (ra, dec)), window=window, observer=None
        )

    south, north = above(-90, middle), above(middle, 90)
    gap = above(middle + 0.01, 90)
    for jobs, covered in (([south, north], True), ([south], False), ([south, gap], False), ([north, south, gap], True)):
        assert plan._covered(SimpleNamespace(merge_bricks={pix: jobs})) == [pix] * covered
    # the brick itself, and none other
    assert plan._covered(SimpleNamespace(merge_bricks={pix: [south], pix + 1: [above(-90, 90)]})) == [pix + 1]


def printed(thing):
    text = io.StringIO()
    Console(file=text, width=120).print(thing)
    return text.getvalue()


def rows_of(text):
    return [[cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if line.startswith("│")]


def test_the_table_has_a_row_for_each_rule():
    rows = rows_of(printed(plan._cost_table(COSTS)))
    assert rows == [
        ["truth", "2", "22.5", "0.01", "800"], ["psf", "2", "25.0", "0.01", "1"],
        ["render", "2", "3.0", "0.00", "1,500"],
        ["measure", "1", "7.0", "0.00", "10"], ["extract", "1", "11.0", "0.00", "10"],
        ["(chip)", "1", "10,000.0", "2.78", "1"], ["report", "1", "3,000.0", "0.83", "1"],
    ]  # fmt: skip


def test_the_plan_is_printed_with_times_of_all_cores(planned, monkeypatch, capsys):
    """CPU 3119 s; the chain is truth 40, render 4, extract 11, report 3000; 64 s are shared out, 3 at the start."""
    planned(kept=JOBS[:1])
    run = opened()
    run.title, run.file, run.variants = "mine", "c.yaml", ()
    monkeypatch.setattr(plan.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(plan, "_print_sky", lambda run, sky: None)
    monkeypatch.setattr(plan, "selection_notes", lambda run: [f"chip 29 of {run.title}: nothing" + 200 * " all"])
    monkeypatch.setenv("COLUMNS", "120")
    plan.print_plan(run)
    said = capsys.readouterr().out
    assert "mine (c.yaml)" in said and "37,000" in said and "disk: light kept" in said and "0.01 GB" in said
    assert "CPU time, estimated for one core of an AMD EPYC: 52.0 min" in said
    # 3 + 3055 + 64 / 2 = 3090 s; 3 + 3055 + 1 = 3059 s
    assert "51.5 min on 2, 51.0 min on 64 cores (longest chain of jobs: 50.9 min)" in said
    assert said.splitlines()[-1] == "note: chip 29 of mine: nothing" + 200 * " all"


def test_light_that_is_made_again_and_the_sky_are_told_after_the_tables(planned, monkeypatch, capsys, tmp_path):
    planned()
    run, asked = opened(), []
    run.title, run.file, run.variants = "mine", "c.yaml", (1,)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(plan, "_variants_table", lambda run: "VARIANTS")
    monkeypatch.setattr(plan, "selection_notes", lambda run: [])
    monkeypatch.setattr(sky_ranges, "check_file", lambda run, file: asked.append(file))
    monkeypatch.setattr(sky_ranges, "skies", lambda run: ({"r": 1}, {"11": 2}))
    monkeypatch.setattr(sky_ranges, "sky_table", lambda levels: f"SKY {levels}")
    monkeypatch.setattr(sky_ranges, "sky_lines", lambda levels, angles: [f"ANGLES {angles}"])
    monkeypatch.setattr(sky_ranges, "write_skies", lambda *given: asked.append(given))
    for again, said in ((2, "2 finished chips must be rendered again"), (0, None)):
        monkeypatch.setattr(plan, "_rendered_again", lambda run, again=again: again)
        plan.print_plan(run, tmp_path / "sky.csv")
        text = capsys.readouterr().out
        assert ("rendered again" in text) == (again > 0) and (said or "") in text
        *before, table, line, last = text.splitlines()
        assert (table, line) == ("SKY {'r': 1}", "ANGLES {'11': 2}") and "VARIANTS" in before
        assert last == f"{tmp_path / 'sky.csv'}: the sky of each exposure and band"
    assert asked == [tmp_path / "sky.csv", (tmp_path / "sky.csv", {"r": 1}, {"11": 2})] * 2
    plan.print_plan(run)
    assert len(asked) == 4 and "sky of each" not in capsys.readouterr().out
    monkeypatch.setattr(sky_ranges, "skies", lambda run: ({}, {}))
    plan.print_plan(run)
    assert "SKY" not in capsys.readouterr().out


def test_the_table_of_variants_says_what_each_makes_and_changes(monkeypatch):
    def of(run):
        return {"jobs": 1234}, {"Level-0": 5.678e9}, {"render": {1: Cost(3600.0, 1), 2: Cost(1800.0, 1)},
                                                    "chip": {1: Cost(1e6, 1)}}  # fmt: skip

    monkeypatch.setattr(plan, "plan", of)
    keys = {"a": {"psf": {"grid": 5}, "seed": 7}, "b": {"fidelity": "preview"}}
    run = SimpleNamespace(
        variants=[SimpleNamespace(variant="a"), SimpleNamespace(variant="b")], config=SimpleNamespace(variants=keys)
    )
    assert rows_of(printed(plan._variants_table(run))) == [
        ["a", "psf.grid: 5, seed: 7", "1,234", "1.50", "5.68"], ["b", "fidelity: preview", "1,234", "1.50", "5.68"],
    ]  # fmt: skip


def test_chips_are_rendered_again_for_a_variant_that_reads_their_light(tmp_path):
    """Light is gone and the frame is there: of jobs that a variant reads out anew, not whose frame it takes."""

    class Paths:
        def __init__(self, frames, light):
            self.frames, self.light = frames, light

        def level0(self, job):
            return SimpleNamespace(exists=lambda: job.key in self.frames)

        def stage(self, obsid, chip, name):
            assert name == "render.fits"
            return SimpleNamespace(exists=lambda: (obsid, chip) in self.light)

    def variant(equal):
        return SimpleNamespace(jobs=JOBS, in_base=lambda obsid, chip, stage: stage in equal.get((obsid, chip), ()))

    a, b, c = (one.key for one in JOBS)
    variants = variant({a: ("render",), b: ("render", "level0"), c: ("render",)}), variant({a: ("render",)})
    for frames, light, again in (({a, b, c}, set(), 2), ({a, b, c}, {a}, 1), ({b, c}, set(), 1), (set(), set(), 0)):
        run = SimpleNamespace(variants=variants, jobs=JOBS, paths=Paths(frames, light))
        assert plan._rendered_again(run) == again


@pytest.mark.parametrize(("seconds", "words"), [
    (59.4, "59 s"), (60, "1.0 min"), (3599, "60.0 min"), (3600, "1.0 h"), (359_000, "99.7 h"), (3.6e6, "1,000 h"),
])  # fmt: skip
def test_spans_of_time(seconds, words):
    assert plan.duration(seconds) == words


CHAINED = {
    "truth": {1: Cost(40.0, 1.0), 2: Cost(5.0, 1.0)}, "psf": {9: Cost(30.0, 1.0)},
    "select": {("a", 9): Cost(2.0, 1.0), ("b", 9): Cost(3.0, 1.0)}, "measure": {("a", 9): Cost(7.0, 1.0)},
    "extract": {("a", 1): Cost(11.0, 1.0)}, "chip": {("a", 9): Cost(1000.0, 1.0)}, "report": {None: Cost(1.5, 1.0)},
}  # fmt: skip


def test_the_wall_is_the_longest_chain_and_the_rest_shared_out():
    """Chain: truth 40 (beside psf), select 3, extract 11 (beside measure), report 1.5; in all 99.5 CPU s."""
    assert plan._chain(CHAINED) == 55.5
    assert plan.wall_time(CHAINED, 1) == pytest.approx(3 + 99.5)
    assert plan.wall_time(CHAINED, 4) == pytest.approx(3 + 55.5 + 11)


def test_exposures_are_listed_with_their_chips_by_filter(monkeypatch, capsys):
    start = datetime(2027, 11, 20, 1, 20, tzinfo=UTC)
    exposures = {
        "2": SimpleNamespace(type="SCIE", start=start, exptime=150.0),
        "1": SimpleNamespace(type="DARK", start=start + timedelta(minutes=5), exptime=0.5),
    }
    chips = [("2", 9, "r"), ("2", 22, "r"), ("2", 7, "i"), ("1", 9, "r")]
    jobs = [SimpleNamespace(obsid=o, chip=SimpleNamespace(id=n, filter=f), pointing=exposures[o]) for o, n, f in chips]
    monkeypatch.setenv("COLUMNS", "80")
    plan.print_exposures(SimpleNamespace(jobs=jobs, exposures=exposures))
    rows = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert rows[-2:] == ["2 SCIE 2027-11-20 01:20:00 150 r: 9 22; i: 7", "1 DARK 2027-11-20 01:25:00 0.5 r: 9"]
