"""Every kind of fault put into a sound campaign is found and named; a sound one has none."""

import os
from functools import cache
from itertools import zip_longest
from types import SimpleNamespace

import numpy as np
import pytest
import spoil
import yaml
from support.commands import command, done
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.campaign.job_lists import CALIBRATIONS
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.delivery.contents import of_campaign
from csstsim.delivery.frame_checks import _rendered, light
from csstsim.delivery.products import products
from csstsim.delivery.verify import verify
from csstsim.io.frames import save_frame
from csstsim.io.paths import Paths
from csstsim.stages.masters import masters_recipe

LEVEL0 = "level0/10100000001/*_09_L0_V01.fits"
TRUTH, ORDERS = "level0/10100000001/*_09*.truth.parquet", "level0/10100000001/*_29*.orders.parquet"
CAT = "level0/10100000001/*_09*.cat"
MEASURED, MERGED, SPECTRA = "measure/*.parquet", "merge/dataset/Norder=8/Dir=550000/Npix=550615.parquet", "spectra/*"
ALONE = "also without the campaign"


def faults(path, *options):
    """Verify; return the lines about faults. The last line and the exit code must agree with them."""
    result = command("verify", path, *options)
    *lines, last = result.output.splitlines()
    assert result.exit_code == (1 if lines else 0), (result.output, result.exception)
    assert last.endswith("sound" if not lines else "1 fault" if len(lines) == 1 else f"{len(lines)} faults")
    return lines


@cache
def opened(file):
    return OpenCampaign(file)


def verified(file, folder, with_campaign):
    """The same lines without the command line, and the campaign opened once."""
    run, lines = None, []
    if with_campaign:
        run = opened(file)
        run.paths = Paths(folder)
    count = verify(run, folder, lines.append)
    assert count == len(lines) - 1
    return lines[:-1]


def test_a_sound_campaign_has_no_fault(sound):
    file, folder = sound
    assert faults(file) == [] and faults(folder) == []
    for name in ("logs", ".snakemake"):
        assert not (folder / name).exists()


def test_satellites_have_no_orders(copied):
    """A satellite crosses a spectroscopic chip: its light is in the truth alone, and that is sound."""
    file, folder = copied
    [path] = folder.glob(ORDERS.replace("orders", "truth"))
    satellite = np.arange(len(ObjectTable.read(path))) == 0
    spoil.column("method", lambda v: np.where(satellite, "track", v))(path)
    [orders] = folder.glob(ORDERS)
    table = ObjectTable.read(orders)
    table.take(table["row"] != 0).write(orders)
    assert not [line for line in faults(file, "--output", folder) if "add up" in line]
    spoil.column("method", lambda v: np.where(satellite, "photons", v))(path)
    assert any("the orders of 1 object do not add up" in line for line in faults(file, "--output", folder))


def test_a_copy_need_not_lie_where_its_campaign_left_it(copied):
    file, folder = copied
    (folder / "campaign.json").write_text('{"name": "mini", "file": "../elsewhere.yaml"}')
    assert faults(file, "--output", folder) == []


# what is spoiled, how, the words of the fault; ALONE where the folder alone shows it, too
ONE = [
    (LEVEL0, spoil.flip, ["damaged", "CHECKSUM"], ALONE),
    (LEVEL0, spoil.cut, ["cut short"]),
    (LEVEL0, spoil.remove, ["missing (Level-0)"], ALONE),
    (LEVEL0, spoil.append, ["4 bytes follow"]),
    (LEVEL0, spoil.header(0, "CAMHASH", lambda _: "0" * 16), ["another campaign", "camera", "0000"]),
    (LEVEL0, spoil.header(0, "EXPHASH", lambda _: "0" * 16), ["another campaign", "exposure", "0000"]),
    (LEVEL0, spoil.header(0, "OBSID", lambda _: "10100000009"), ["OBSID", "10100000009"]),
    (LEVEL0, spoil.header(0, "FILTER", lambda _: "i"), ["FILTER", "'i'"]),
    (LEVEL0, spoil.header(0, "NEXTEND", lambda _: 2), ["1 extensions, not the 2"]),
    (LEVEL0, spoil.header(1, "CLIPLOW", lambda _: 10**6), ["at 0 DN", "layer bias"]),
    (TRUTH, spoil.scratch, ["parquet"]),
    (TRUTH, spoil.remove, ["missing (truth)"], ALONE),
    (TRUTH, spoil.record(lambda meta: meta["recipe"].update(layers="0" * 16)), ["another campaign: layers"], ALONE),
    (TRUTH, spoil.record(lambda meta: meta.update(recipe=None)), ["another campaign: recipe None"]),
    (TRUTH, spoil.record(lambda meta: meta.update(level0="other.fits")), ["is of 'other.fits'"]),
    (TRUTH, spoil.column("ID_chip", lambda v: v + 1), ["another chip than 9"]),
    (TRUTH, spoil.column("x1", lambda v: v + 1000), ["boxes beyond the window"]),
    (TRUTH, spoil.record(lambda meta: meta.update(electrons="many")), ["is inconsistent"]),
    (TRUTH, spoil.record(lambda meta: meta.pop("full_well")), ["is inconsistent", "full_well"]),
    (TRUTH, spoil.column("drawn", lambda v: v.astype(str)), ["is inconsistent"]),
    (CAT, spoil.text(" star ", " galaxy "), ["is not the text of", "truth.parquet"]),
    (CAT, spoil.text(" r ", " "), ["no heading"]),
    (CAT, spoil.remove, ["missing (truth as text)"]),
    (MERGED, spoil.column("n_detections", lambda v: v.astype(str)), ["not as long as"]),
    (ORDERS, spoil.column("row", lambda v: v + 1000), ["not among the"]),
    (ORDERS, spoil.column("id", lambda v: v + 1), ["another one in the truth"]),
    (ORDERS, spoil.column("drawn", lambda v: 1.01 * v), ["do not add up to their light"]),
    (ORDERS, spoil.remove, ["missing (truth of orders)"]),
    ("level0/*/*_09*.cosmic.fits", spoil.flip, ["CHECKSUM"]),
    ("level0/*/*_09*.cosmic.fits", spoil.remove, ["missing (cosmic rays)"]),
    ("calibrated/*_09.fits", spoil.flip, ["CHECKSUM"]),
    ("calibrated/*_09.fits", spoil.remove, ["missing (calibrated)"]),
    ("measure/*_09.residual.fits", spoil.flip, ["CHECKSUM"]),
    ("measure/*_09.residual.fits", spoil.remove, ["missing (residual)"]),
    (MEASURED, spoil.remove, ["missing (measured)"], ALONE),
    (MEASURED, spoil.record(lambda meta: meta.update(sources=3)), ["its record says 3"]),
    (MEASURED, spoil.record(lambda meta: meta["recipe"].update(camera="x")), ["another campaign: camera 'x'"], ALONE),
    (MEASURED, spoil.column("obsid", lambda v: np.full(len(v), "7")), ["another obsid"]),
    (MEASURED, spoil.column("x", lambda v: v + 200.0), ["beyond the window"], ALONE),
    (MEASURED, spoil.column("dec", lambda v: v * np.nan), ["are out of range"]),
    (MEASURED, spoil.column("number", lambda v: v[::-1]), ["does not count the rows"]),
    ("spectra/*_29.parquet", spoil.remove, ["missing (spectra)"]),
    ("spectra/*_29.parquet", spoil.scratch, ["parquet"]),
    ("spectra/*_lines.parquet", spoil.remove, ["missing (line fluxes)"]),
    ("spectra/*_lines.parquet", spoil.record(lambda meta: meta["recipe"].update(camera="x")), ["camera 'x'"]),
    ("spectra/*.png", spoil.flip, ["PNG"]),
    (MERGED, spoil.record(lambda meta: meta.update(brick=5)), ["is of brick 5"]),
    (MERGED, spoil.record(lambda meta: meta.update(recipe="0")), ["another campaign: recipe '0'"]),
    (MERGED, spoil.column("ra", lambda v: v + 1.0), ["another brick"]),
    (MERGED, spoil.column("n_detections", lambda v: v + 1), ["not as long as n_detections"]),
    (MERGED, spoil.lists("detection_number", 999), ["beyond the", "rows measured"], ALONE),
    (MERGED, spoil.lists("detection_chip", 8), ["10100000001_08, which is not among the frames"], ALONE),
    (MERGED, spoil.lists("detection_filter", "z"), ["are not in r"]),
    ("merge/partition_info.csv", spoil.text("8,550615\n", ""), ["does not list the bricks"], ALONE),
    ("merge/hats.properties", spoil.text("hats_nrows=", "hats_nrows=9"), ["hats.properties counts 9"], ALONE),
    ("merge/dataset/_metadata", spoil.remove, ["missing (merged catalogue)"]),
    ("validate/550615.json", spoil.cut, ["JSON"]),
    ("validate/550615.json", spoil.entry(lambda v: v.update(recipe="0")), ["another campaign: recipe '0'"], ALONE),
    ("validate/550615.json", spoil.entry(lambda v: v.update(brick=4)), ["no validation of brick 550615"]),
    ("validate/550615.png", spoil.flip, ["PNG"]),
    ("report/index.html", spoil.cut, ["cut short"]),
    ("report/verdict.json", spoil.entry(lambda v: v["gates"].pop()), ["make the report again"]),
    ("report/verdict.json", spoil.remove, ["missing (verdict)"]),
    ("psf/chip_09.h5", spoil.scratch, ["image"]),
    ("psf/chip_09_tables.h5", spoil.flip, ["damaged at node"]),
]  # fmt: skip


def rounds(cases, with_campaign):
    """Return the cases in lists of those that can be put in together: of files whose checks know nothing of each other.

    A Level-0 file is checked with its truth, a table with what is merged, validated and evaluated of it. Without the
    campaign, what a table must record stands in the Level-0 file.
    """
    together = {
        LEVEL0: "chip", TRUTH: "chip", MEASURED: "sky", MERGED: "sky", "merge/hats.properties": "sky",
        "merge/dataset/_metadata": "sky", "validate/550615.json": "sky", "report/verdict.json": "sky",
    }  # fmt: skip
    groups = {}
    for case in cases:
        group = together.get(case[0], case[0])
        groups.setdefault("chip" if group == "sky" and not with_campaign else group, []).append(case)
    return [[case for case in cases if case] for cases in zip_longest(*groups.values())]


def check_faults(copied, cases, with_campaign):
    """Put in the faults of a round: a line each, of its file, in its words, and no other."""
    file, folder = copied
    wanted = {}
    for pattern, fault, words, *_ in cases:
        (path,) = folder.glob(pattern)
        fault(path)
        wanted[path.relative_to(folder).as_posix()] = words
    found = verified(file, folder, with_campaign)
    lines = dict(line.split(": ", 1) for line in found)
    assert lines.keys() == wanted.keys() and len(found) == len(wanted), found
    for name, words in wanted.items():
        assert all(word in lines[name] for word in words), (name, lines[name])


@pytest.mark.parametrize("cases", rounds(ONE, True))
def test_one_fault_is_one_line(copied, cases):
    check_faults(copied, cases, True)


@pytest.mark.parametrize("cases", rounds([case for case in ONE if ALONE in case], False))
def test_one_fault_is_one_line_without_the_campaign(copied, cases):
    check_faults(copied, cases, False)


def test_a_frame_that_says_to_be_another_one_is_named_by_each_keyword(copied):
    """Chip, type, name and world coordinates of the header, and the PSF set with which the frame was rendered."""
    file, folder = copied
    (path,) = folder.glob(LEVEL0)
    for key, value in (("DETECTOR", "08"), ("FILETYPE", "BIAS"), ("FILENAME", "other"), ("PSFHASH", "0" * 16)):
        spoil.header(0, key, lambda _, value=value: value)(path)
    spoil.header(1, "CRVAL2", lambda dec: dec + 1 / 3600)(path)
    lines = verified(file, folder, True)
    name = path.relative_to(folder).as_posix()
    assert lines == [
        f"{name}: DETECTOR is '08', not '09'", f"{name}: FILETYPE is 'BIAS', not 'SCIE'",
        f"{name}: FILENAME is 'other', not '{path.stem}'",
        f"{name}: the pointing by CRVAL1 is 1 arcsec off the campaign's",
        f"psf/chip_09.h5: is not the set that {path.name} was rendered with",
    ]  # fmt: skip


def test_a_frame_of_another_window_is_named(sound, tmp_path):
    other = tmp_path / "other.yaml"
    window = {"window": {"x0": 0, "x1": 100, "y0": 0, "y1": 128}}
    other.write_text(yaml.safe_dump(yaml.safe_load(sound[0].read_text()) | window))
    lines = [line for line in faults(other, "--output", sound[1]) if "its window is" in line]
    assert len(lines) == 4 and all(
        line.endswith("_L0_V01.fits: its window is (0, 128, 0, 128), not (0, 100, 0, 128)") for line in lines
    )


def test_what_may_be_missing_without_a_word(copied):
    """Every file is removed: all are named, but what a user may have left out or taken away."""
    file, folder = copied
    had = {p.kind for p in products(of_campaign(opened_in(file, folder))) if p.path.is_file()}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        path.unlink()
    lines = verified(file, folder, True)
    named = {folder / line.split(": ")[0] for line in lines if ": missing (" in line}
    wanted = products(of_campaign(opened_in(file, folder)))
    silent = {product.kind for product in wanted if product.path not in named} | had - {p.kind for p in wanted}
    assert silent == {"comparison of variants"} and len(had) > 12, (silent, had)


def opened_in(file, folder):
    run = opened(file)
    run.paths = Paths(folder)
    return run


def test_two_sources_with_one_detection(copied):
    file, folder = copied
    (path,) = folder.glob(MERGED)
    from csstsim.catalog.table import ObjectTable

    spoil.lists("detection_number", int(ObjectTable.read(path)["detection_number"][1][0]))(path)
    (line,) = verified(file, folder, True)
    assert "belongs to two sources" in line


@pytest.mark.parametrize(
    ("pattern", "fault", "words"),
    [
        (TRUTH, spoil.column("drawn", lambda v: v * 1.001), ["truth.parquet", "objects sum to", "the image was given"]),
        (TRUTH, spoil.rows(slice(1, None)), ["truth.parquet", "objects sum to"]),
        (LEVEL0, spoil.pixels(lambda v: np.where(v > 0, np.median(v), 0)), ["truth.parquet", "the image holds"]),
        (LEVEL0, spoil.pixels(lambda v: np.where(v > 600, 600, v)), ["truth.parquet", "the image holds"]),
        (LEVEL0, spoil.header(1, "GAIN03", lambda v: 1.3 * v), ["truth.parquet", "the image holds"]),
    ],
)
def test_light_that_is_not_in_the_image(copied, pattern, fault, words):
    file, folder = copied
    (path,) = folder.glob(pattern)
    fault(path)
    for with_campaign in (True, False):
        (line,) = verified(file, folder, with_campaign)
        assert all(word in line for word in words), line


def test_what_is_foreign(copied):
    file, folder = copied
    (folder / "logs" / "deep").mkdir(parents=True)
    (folder / "logs" / "deep" / "a.log").write_text("fine")
    for name in ("chosen", "look", "benchmarks", "variants", "workflow"):  # what commands write beside products
        (folder / name / "below").mkdir(parents=True)
        (folder / name / "below" / "a.txt").write_text("fine")
    (folder / "ro-crate-metadata.json").write_text("{}")
    (folder / "measure" / "logs").mkdir()
    (folder / "measure" / "logs" / "a.log").write_text("not there")
    (folder / "empty").mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "measure" / "evil\n\x1b[31m\udcff.parquet").write_text("")
    (folder / "old" / "below").mkdir(parents=True)
    for name in "ab":
        (folder / "old" / "below" / name).write_text("")
    (folder / "chips" / "1_09").mkdir(parents=True)
    (folder / "chips" / "1_09" / "select.parquet").write_text("")
    (folder / "psf" / ".chip_09.77.tmp.h5").write_text("")
    (folder / "loop").symlink_to(folder)
    starts = [
        "chips: intermediates", "loop: foreign: a link", "measure/evil\\n\\x1b[31m\\udcff.parquet: foreign",
        "measure/logs: foreign", "notes.txt: foreign", "old: foreign", "psf/.chip_09.77.tmp.h5: an incomplete file",
    ]  # fmt: skip
    for with_campaign in (True, False):
        lines = sorted(verified(file, folder, with_campaign))
        assert len(lines) == len(starts)
        assert all(line.startswith(start) for line, start in zip(lines, starts, strict=True)), lines


def test_products_that_are_no_files(copied):
    """Reading a pipe would never end; a link delivers nothing."""
    file, folder = copied
    pipe, link, place = folder / "report" / "index.html", folder / "psf" / "chip_09.h5", folder / "psf" / "chip_29.h5"
    pipe.unlink()
    os.mkfifo(pipe)
    link.rename(folder.parent / "elsewhere.h5")
    link.symlink_to(folder.parent / "elsewhere.h5")
    place.unlink()
    place.mkdir()
    lines = verified(file, folder, True)
    assert [line.split(": ", 1)[0] for line in lines] == ["psf/chip_09.h5", "psf/chip_29.h5", "report/index.html"]
    assert all("not a file" in line for line in lines)


def test_another_campaign(sound, tmp_path):
    """The seed decides all: every product of the sky and of the chip is another's."""
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(yaml.safe_load(sound[0].read_text()) | {"seed": 4}))
    lines = faults(other, "--output", sound[1])
    assert sum("another campaign" in line for line in lines) >= 10
    assert all("another campaign" in line for line in lines)


def test_frames_of_two_campaigns_in_one_folder(copied):
    _, folder = copied
    for path in folder.glob("level0/*/*_29_L0_V01.fits"):
        spoil.header(0, "CAMPHASH", lambda _: "f" * 16)(path)
        break
    assert any("another campaign than most: campaign 'ffffffffffffffff'" in line for line in faults(folder))


def test_a_partial_campaign_misses_what_it_has_not(tmp_path):
    """Truth bricks only, of the embedded Universe: one whole, one damaged; all else is missing, by name."""
    file = write_campaign(tmp_path, POINTINGS[:1])
    assert "nothing was made yet" in command("verify", file).output
    run = OpenCampaign(file)
    bricks = run.truth_bricks(run.jobs[0])
    done("truth", file, "--brick", bricks[0])
    lines = faults(file)
    missing = [line for line in lines if "missing (" in line]
    assert missing == lines and sum("missing (truth brick)" in line for line in lines) == len(bricks) - 1
    assert sum("missing (Level-0)" in line for line in lines) == 1
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"seed": 4}))
    [line] = [line for line in faults(other) if "missing" not in line]
    assert line.startswith("truth/dataset/Norder=8/") and "another" in line
    spoil.flip(run.paths.truth(bricks[0]))
    assert next(line for line in faults(file) if "missing" not in line).startswith("truth/dataset/Norder=8/")


def test_masters_are_products_of_whole_calibration_exposures(tmp_path):
    """Of another chip they are named; those that were never made are missing, a chip each."""
    pointings = [f"1030000{k:04},{kind},0,0,0,2027-11-20T{k:02}:00:00,{0 if kind == 'BIAS' else 150}"
                 for k, kind in enumerate(3 * CALIBRATIONS)]  # fmt: skip
    select = {"types": list(CALIBRATIONS), "chips": [7, 9]}
    file = write_campaign(tmp_path, pointings, select=select)
    run = OpenCampaign(file)
    plane = np.zeros((4, 4), np.float32)
    for chip in (7, 9):
        save_frame(run.paths.masters(chip), {"flat": plane, "bad": plane}, masters_recipe(run, 7))
    of_masters = [line for line in faults(file) if line.startswith("masters/")]
    assert len(of_masters) == 1 and of_masters[0].startswith("masters/chip_09.fits: "), of_masters
    run.paths.masters(9).unlink()
    assert "masters/chip_09.fits: missing (masters)" in faults(file)


@pytest.mark.parametrize("make", [lambda p: p / "none.yaml", lambda p: p, lambda p: (p / "level0").mkdir() or p])
def test_nothing_to_verify(tmp_path, make):
    result = command("verify", make(tmp_path))
    assert result.exit_code == 2 and len(result.output.splitlines()) == 1, result.output


def test_an_object_whose_wing_alone_reaches_the_window_has_no_box():
    def faults_of(*boxes):
        box = dict(zip(("x0", "x1", "y0", "y1"), np.transpose(boxes), strict=True))
        place = dict.fromkeys(("x", "y", "drawn"), np.ones(len(boxes)))
        return list(_rendered(ObjectTable(place | box), SimpleNamespace(window=(100, 200, 0, 50))))

    assert faults_of((100, 120, 0, 50), (0, 0, 0, 0)) == []
    assert faults_of((100, 120, 0, 50), (99, 120, 0, 50)) == ["1 object rendered in boxes beyond the window"]


@pytest.mark.parametrize(("name", "value", "words"), [
    ("drawn", -1.0, "negative or not finite"), ("drawn", np.nan, "negative or not finite"),
    ("drawn", np.inf, "negative or not finite"), ("x", np.nan, "position is not finite"),
    ("y", np.inf, "position is not finite"),
])  # fmt: skip
def test_light_and_places_that_no_object_can_have(name, value, words):
    table = {column: np.ones(3) for column in ("x", "y", "drawn")}
    frame = SimpleNamespace(window=None)
    assert list(_rendered(ObjectTable(table), frame)) == []
    table[name][1] = value
    assert any(words in line for line in _rendered(ObjectTable(table), frame))


@pytest.mark.parametrize("kind", ["frame", "table"])
def test_kept_light_has_the_recipe_of_its_campaign(tmp_path, kind):
    def found(recipe, expected):
        path = tmp_path / ("render.fits" if kind == "frame" else "drawn.parquet")
        if kind == "frame":
            save_frame(path, {"image": np.zeros((2, 2), np.float32)}, {"recipe": recipe})
        else:
            table = ObjectTable({"id": np.arange(2)})
            table.meta = {"recipe": recipe} if recipe else {}
            table.write(path)
        return list(light(path, expected))

    ours, theirs = {"layers": "1", "psf": "2"}, {"layers": "1", "psf": "3"}
    assert found(ours, ours) == [] and found(ours, None) == []
    assert found(theirs, ours) == ["made for another campaign: psf '3', not '2'"]
    assert found(None, ours) != []
