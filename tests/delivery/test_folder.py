"""What a folder's names and headers say of its frames and bricks, without a campaign."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.commands import command, done
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.catalog.table import ObjectTable
from csstsim.delivery import folder as folder_module
from csstsim.delivery import verify
from csstsim.delivery.contents import CHECKED, MAYBE, NO, YES, Contents, ExpectedFrame
from csstsim.delivery.folder import _inconsistent, _listed, _measurement, _stems, _with_kinds, of_folder
from csstsim.delivery.frame_checks import light
from csstsim.delivery.products import Product, products
from csstsim.io.frames import save_frame
from csstsim.io.paths import ORDERS, Paths

STEM = "CSST_MSC_MS_{}_20270810081950_20270810082220_{}_{:02d}_L0_V01"


def frame(folder, obsid="100000100", chip=9, **fields):
    values = {
        "filter": "r", "type": "SCIE", "level0": folder / "level0" / obsid / f"{STEM.format('WIDE', obsid, chip)}.fits",
        "recipe": None, "rays_recipe": None, "window": None, "measured": MAYBE, "extracted": MAYBE, "cosmic": MAYBE,
    }  # fmt: skip
    return ExpectedFrame(obsid, chip, **values | fields)


def test_a_folder_of_names_alone(tmp_path):
    """Empty files: each name says which frame or brick is there; those in other places say nothing."""
    one, bias = STEM.format("WIDE", "100000100", 9), STEM.format("BIAS", "100000200", 7)
    for name in (
        f"level0/100000100/{one}.fits", f"level0/100000200/{bias}.truth.parquet", f"level0/100000300/{one}.fits",
        f"level0/{one}.fits", f"level0/a/100000100/{one}.fits", "level0/100000100/notes.fits",
        "merge/dataset/Norder=8/Dir=0/Npix=77.parquet", "merge/dataset/Npix=1234567.parquet", "validate/5.json",
        "validate/x.json", "truth/dataset/Norder=8/Dir=0/Npix=8.parquet", "masters/chip_07.fits", "masters/chip_7.fits",
        "chips/1_09/render.fits", "chips/1_09/drawn.parquet", "chips/1_09/select.parquet",
    ):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "merge" / "partition_info.csv").write_text("Norder,Npix\n8,6\n7,9\n")
    (tmp_path / "truth" / "partition_info.csv").write_text("Norder,Npix\n8,3\n")
    found = of_folder(tmp_path)
    assert [(f.key, f.type, f.level0.name, f.measured, f.extracted, f.cosmic) for f in found.frames] == [
        (("100000100", 9), "SCIE", f"{one}.fits", MAYBE, MAYBE, MAYBE),
        (("100000200", 7), "BIAS", f"{bias}.fits", NO, NO, MAYBE),
    ]  # fmt: skip
    assert (found.bricks, found.truth, found.masters) == ({5: None, 6: None, 77: None}, {3: None, 8: None}, {7: None})
    assert sorted(path.name for path in found.light) == ["drawn.parquet", "render.fits"]
    assert (found.report, found.calibrated, found.joint, found.cat) == (YES, MAYBE, MAYBE, MAYBE)
    assert found.measurement is None
    assert list(found.psf) == [9]
    (tmp_path / "level0" / "100000100" / f"{one}.fits").unlink()
    assert of_folder(tmp_path).report == MAYBE and [f.type for f in of_folder(tmp_path).frames] == ["BIAS"]


def test_stems_are_those_in_the_folder_of_their_exposure(tmp_path):
    name = STEM.format("WIDE", "100000100", 9)
    for place in ("100000100", "100000200", "100000100/100000100"):
        (tmp_path / place).mkdir(parents=True, exist_ok=True)
        (tmp_path / place / f"{name}.truth.parquet").write_bytes(b"")
    assert _stems(tmp_path) == [(("SCIE", "100000100", 9), tmp_path / "100000100" / f"{name}.fits")]


def test_a_filter_with_orders_is_a_grating(tmp_path):
    """In one frame of it, or by its table of spectra; other filters are measured, unknown ones may be."""
    frames = [frame(tmp_path, chip=k, filter=f) for k, f in ((1, "GI"), (2, "GI"), (3, "r"), (4, "GV"), (5, None))]
    frames.append(frame(tmp_path, chip=6, filter="GI", type="FLAT", measured=NO, extracted=NO))
    frames[1].companion(ORDERS).parent.mkdir(parents=True)
    frames[1].companion(ORDERS).write_bytes(b"")
    paths = Paths(tmp_path)
    (tmp_path / "spectra").mkdir()
    paths.spectra(*frames[3].key).write_bytes(b"")
    assert [(f.measured, f.extracted) for f in _with_kinds(frames, paths)] == [
        (NO, MAYBE), (NO, MAYBE), (YES, NO), (NO, MAYBE), (MAYBE, MAYBE), (NO, NO),
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["csstsim", "campaign", "camera", "layers"])
def test_the_odd_frame_among_three_is_named(tmp_path, name):
    """Layer lists differ between the types of exposures; those of one type agree."""
    recipes = [{"csstsim": "0.1", "campaign": "c", "camera": "i", "layers": "l", "exposure": str(k)} for k in range(3)]
    frames = [frame(tmp_path, chip=k + 1, recipe=recipe) for k, recipe in enumerate(recipes)]
    frames.append(frame(tmp_path, chip=7, type="BIAS", recipe=recipes[0] | {"layers": "b"}))
    assert _inconsistent([*frames, frame(tmp_path, chip=8)]) == []
    recipes[1][name] = "x"
    usual = recipes[0][name]
    assert _inconsistent(frames) == [
        (frames[1].level0, f"made for another campaign than most: {name} 'x', not '{usual}'")
    ]  # fmt: skip


def test_the_way_of_measuring_is_that_of_the_first_table_that_can_be_read(tmp_path):
    frames, paths = [frame(tmp_path, chip=k) for k in (1, 2, 3)], Paths(tmp_path)
    assert _measurement(paths, frames) is None
    for number, path in ((2, paths.spectra(*frames[1].key)), (3, paths.measure(*frames[2].key))):
        path.parent.mkdir()
        ObjectTable({"a": [1]}).write(path, {"recipe": {"measurement": f"m{number}"}})
    paths.measure(*frames[0].key).write_bytes(b"damaged")
    assert _measurement(paths, frames) == "m2"
    ObjectTable({"a": [1]}).write(paths.spectra(*frames[1].key), {"recipe": "text"})
    assert _measurement(paths, frames) is None


@pytest.mark.parametrize(("text", "bricks"), [
    ("Norder,Npix\n8,5\n8,123456\n", {5, 123456}), ("8,1\n8,5\n", {5}), ("", set()),
    ("Norder,Npix\n7,5\n8,1234567\n8,x\n8,\n", set()),
])  # fmt: skip
def test_bricks_that_a_catalogue_lists(tmp_path, text, bricks):
    (tmp_path / "p.csv").write_text(text)
    assert _listed(tmp_path / "p.csv") == bricks and _listed(tmp_path / "none") == set()


def contents(folder, frames, **fields):
    values = {
        "bricks": {5: "b"}, "truth": {6: None}, "masters": {7: None}, "light": {}, "measurement": "m",
        "calibrated": YES, "joint": YES, "report": YES, "cat": NO,
    }  # fmt: skip
    return Contents(paths=Paths(folder), frames=tuple(frames), **values | fields)


def test_products_of_an_image_a_spectrum_and_a_bias(tmp_path):
    """By their kinds; what must not be there is none, so that it is foreign."""
    image = frame(tmp_path, chip=9, measured=YES, extracted=NO, cosmic=YES)
    other = frame(tmp_path, "100000200", 9, measured=YES, extracted=NO, cosmic=NO)
    spectrum = frame(tmp_path, chip=29, measured=NO, extracted=YES, cosmic=NO, filter="GV")
    bias = frame(tmp_path, "100000300", 7, type="BIAS", measured=NO, extracted=NO, cosmic=NO)
    every = contents(tmp_path, [image, other, spectrum, bias], light={tmp_path / "chips" / "render.fits": None})
    found = [(p.kind, p.path.relative_to(tmp_path).as_posix(), p.need) for p in products(every)]
    kinds = [kind for kind, _, _ in found]
    counts = {kind: kinds.count(kind) for kind in kinds}
    assert counts == {
        "Level-0": 4, "truth": 4, "cosmic rays": 1, "calibrated": 2, "measured": 2, "residual": 2, "truth of orders": 1,
        "spectra": 1, "line fluxes": 1, "figure of spectra": 1, "light of a chip": 1, "masters": 1,
        "PSF set": 2, "PSF tables": 2,
        "truth brick": 1, "truth catalogue": counts["truth catalogue"], "merged brick": 1, "merged catalogue": 4,
        "validation": 1, "figure of validation": 1, "report": 1, "comparison of variants": 1, "verdict": 1,
    }  # fmt: skip
    assert {kind for kind, _, need in found if need == MAYBE} == {"truth catalogue", "comparison of variants"}
    assert ("calibrated", "calibrated/100000100_09.fits", YES) in found
    assert ("line fluxes", "spectra/100000100_29_lines.parquet", YES) in found
    assert ("figure of spectra", "spectra/100000100_29.png", YES) in found
    assert every.psf == {9: image, 29: spectrum}
    assert every.measure_recipe(image) is None
    known = frame(tmp_path, recipe={"a": 1})
    assert every.measure_recipe(known) == {"a": 1, "measurement": "m"}
    assert contents(tmp_path, [], measurement=None).measure_recipe(known) is None
    assert "truth as text" in {p.kind for p in products(contents(tmp_path, [image], cat=YES))}
    bare = {p.kind for p in products(contents(tmp_path, [], bricks={}, truth={}, masters={}, report=MAYBE))}
    assert bare == {"report", "comparison of variants", "verdict"}


def test_what_a_check_raises_is_a_fault_of_its_file(tmp_path):
    """In the words of the error, without the file's own name; a missing one is a fault if it must be there."""
    path = tmp_path / "a.fits"

    def faults(error=None, need=YES, requires=()):
        def check():
            yield "one"
            if error:
                raise error

        return list(verify._product_faults(Product("thing", path, need, check, requires)))

    assert faults() == ["missing (thing)"] and faults(need=MAYBE) == []
    save_frame(path, {"image": np.ones((2, 3), np.float32)}, {"recipe": {"a": 1}})
    assert faults() == ["one"] and faults(requires=(path,)) == ["one"] and faults(requires=(tmp_path / "no",)) == []
    assert faults(OSError(5, "broken")) == ["one", "cannot be read: broken"]
    assert faults(KeyError("x")) == ["one", "is inconsistent: KeyError: 'x'"]
    (fault,) = verify._product_faults(Product("light", path, YES, lambda: light(path, {"a": 2})))
    assert fault == "made for another campaign: a 1, not 2"
    path.write_bytes(b"no FITS")
    (fault,) = verify._product_faults(Product("light", path, YES, lambda: light(path, None)))
    assert str(path) not in fault and "FITS" in fault


def test_the_verdict_counts_products_sizes_and_faults(tmp_path, monkeypatch):
    lines = []
    monkeypatch.setattr(verify, "of_folder", lambda folder: SimpleNamespace(paths=Paths(tmp_path), faults=[]))
    paths = [tmp_path / name for name in ("a.txt", "b.txt", "gone.txt")]
    paths[0].write_bytes(b"x" * 1_500_000)
    paths[1].write_bytes(b"y" * 500_000)
    wanted = [Product("k", path, YES, None) for path in paths]
    monkeypatch.setattr(verify, "products", lambda contents: wanted)
    assert verify.verify(None, tmp_path, lines.append, manifest=True) == 1
    assert lines == [
        "gone.txt: missing (k)", f"{tmp_path}: 2 products, 0.002 GB: 1 fault",
        "no manifest was written: the folder has faults",
    ]  # fmt: skip
    del wanted[2]
    lines.clear()
    assert verify.verify(None, tmp_path, lines.append, manifest=True) == 0
    assert lines[0].endswith("2 products, 0.002 GB: sound") and (tmp_path / "MANIFEST.tsv").read_text() == (
        "path\tbytes\tproduct\na.txt\t1500000\tk\nb.txt\t500000\tk\n"
    )
    run = SimpleNamespace(declared_missing={("20", 7): "too\n bright", ("10", 9): "lost"})
    monkeypatch.setattr(verify, "of_campaign", lambda run: SimpleNamespace(paths=Paths(tmp_path), faults=[]))
    assert verify.verify(run, tmp_path, lines.append, manifest=True) == 0
    assert (tmp_path / "MANIFEST.missing").read_text() == "exposure\tchip\treason\n10\t9\tlost\n20\t7\ttoo bright\n"
    listed = [line.split("  ")[1] for line in (tmp_path / "MANIFEST.sha256").read_text().splitlines()]
    assert listed == ["a.txt", "b.txt", "MANIFEST.tsv", "MANIFEST.missing"]
    assert verify.verify(run, tmp_path, lines.append) == 0
    (tmp_path / "a.txt").write_text("other")
    assert verify.verify(run, tmp_path, lines.append) == 1 and "its SHA-256 is not that" in lines[-2]
    run.declared_missing = {}
    assert verify.verify(run, tmp_path, lines.append, manifest=True) == 0 == verify.verify(run, tmp_path, lines.append)
    assert not (tmp_path / "MANIFEST.missing").exists(), "it would tell of frames that are there"


def test_what_the_manifest_lists_must_be_there_even_if_it_may_be_missing(tmp_path, monkeypatch):
    """One that must be there is missed once."""
    monkeypatch.setattr(verify, "of_folder", lambda folder: SimpleNamespace(paths=Paths(tmp_path), faults=[]))
    wanted = [Product("k", tmp_path / "a.txt", YES, None), Product("k", tmp_path / "b.txt", MAYBE, None)]
    monkeypatch.setattr(verify, "products", lambda contents: wanted)
    lines = []
    for product in wanted:
        product.path.write_text("x")
    assert verify.verify(None, tmp_path, lines.append, manifest=True) == 0
    for product in wanted:
        product.path.unlink()
    lines.clear()
    assert verify.verify(None, tmp_path, lines.append) == 2
    assert lines[:2] == ["a.txt: missing (k)", "b.txt: listed in MANIFEST.sha256, but missing"]


def test_the_text_of_a_truth_is_known_under_the_name_that_its_form_has_for_it(tmp_path):
    """Without a campaign, too: the frame of an earlier cycle's form with its two texts."""
    given = {"types": ["BIAS"], "chips": [9]}
    file = write_campaign(tmp_path, [POINTINGS[2]], select=given, level0_names="C5.2", truth=["parquet", "cat"])
    done("chip", file, "--obsid", POINTINGS[2].split(",")[0], "--chip", 9)
    [frame] = of_folder(tmp_path / "out").frames
    assert frame.catalogue.name == "MSC_10300000001_chip_09_filt_r.cat" and frame.catalogue.is_file()
    said = command("verify", tmp_path / "out").output
    assert "foreign" not in said and "4 products" in said, said


def test_a_stage_without_checks_has_its_files_known_by_their_names(tmp_path, monkeypatch):
    assert folder_module._others(tmp_path) == {}
    monkeypatch.setattr(folder_module, "CHECKED", tuple(name for name in CHECKED if name != "measure"))
    (tmp_path / "measure").mkdir()
    for name in ("1_09.parquet", "notes.txt"):
        (tmp_path / "measure" / name).touch()
    assert folder_module._others(tmp_path) == {tmp_path / "measure/1_09.parquet": "measured tables"}
