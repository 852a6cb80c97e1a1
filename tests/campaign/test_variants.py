"""Variants of a campaign: what they take from their base, bits of a campaign alone, one graph, clear errors."""

import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from delivery.small_delivery import science
from support.commands import command, done
from support.mini_campaign import POINTINGS, write_campaign
from support.workflow_run import dry_run

from csstsim.base.errors import InputError
from csstsim.campaign import variants
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.plan import _rendered_again
from csstsim.campaign.running.status import wanted
from csstsim.io.paths import RENDER_PRODUCTS, Paths

BASE = {"select": {"types": ["SCIE"], "chips": [9]}, "keep": "light"}
VARIANTS = {
    "warm": {"instrument": {"detector.temperature": 193.0, "detector.gain": 1.3}},
    "rough": {"measurement": {"cti_passes": 1}},
    "sparse": {"psf": {"grid": 3}},
}


def make(folder, variants=VARIANTS, **changes):
    """A campaign on tiny chips whose camera is given as numbers to change."""
    file = write_campaign(folder, [POINTINGS[0]], **(BASE | changes))
    data = yaml.safe_load(file.read_text())
    data["instrument"] = {"folder": data["instrument"], "detector.gain": 1.2}
    file.write_text(yaml.safe_dump(data | {"variants": variants}))
    return file


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    return make(tmp_path_factory.mktemp("variants"))


def run_of(base, name):
    return OpenCampaign(f"{base}@{name}")


@pytest.fixture(scope="module")
def made(base):
    """The campaign, after the chip and its variants are made."""
    for run in (base, *(f"{base}@{name}" for name in VARIANTS)):
        done("chip", run, "--obsid", "10100000001", "--chip", 9)
    return base


def test_a_variant_is_the_base_with_its_keys(base):
    warm, own = run_of(base, "warm"), OpenCampaign(base)
    assert warm.camera.detector.gain == 1.3 and own.camera.detector.gain == 1.2
    assert warm.config.psf == own.config.psf and not warm.config.variants
    assert warm.paths.output == own.paths.output / "variants" / "warm"
    assert warm.title == "mini, variant warm" and warm.config.name == "mini"  # headers are those of a campaign alone
    assert {run.variant for run in own.variants} == set(VARIANTS) and all(run.base is own for run in own.variants)


def test_a_variant_takes_what_its_keys_do_not_change(base):
    own = OpenCampaign(base).paths
    key = "10100000001", 9
    for name, bricks, sets, light in (("warm", 1, 1, 1), ("rough", 1, 1, 1), ("sparse", 1, 0, 0)):
        run = run_of(base, name)
        assert (run.paths.truth(5) == own.truth(5)) == bricks
        assert (run.paths.psf(9) == own.psf(9)) == sets == (run.paths.psf_tables(9) == own.psf_tables(9))
        assert (run.paths.stage(*key, "render.fits") == own.stage(*key, "render.fits")) == light
        assert run.paths.stage(*key, "select.parquet") == own.stage(*key, "select.parquet")
        assert run.paths.stage(*key, "readout.fits") != own.stage(*key, "readout.fits")
    assert [run_of(base, name).in_base(*key, "level0") for name in VARIANTS] == [False, True, False]
    assert not any(run_of(base, name).in_base(*key, "measure") for name in VARIANTS)
    assert not run_of(base, "rough").in_base("10100000001", 8, "level0")  # no job


def test_another_selection_takes_bricks_of_the_base_alone(tmp_path):
    base = make(tmp_path, {"more": {"select": {"chips": [8, 9]}}})
    run = run_of(base, "more")
    assert run.paths.psf(9) == run.base.paths.psf(9) and run.paths.psf(8) != run.base.paths.psf(8)
    assert [run.in_base("10100000001", chip, "level0") for chip in (8, 9)] == [False, True]


def test_products_have_the_bits_of_a_campaign_alone(made, tmp_path):
    base = made
    job = ["--obsid", "10100000001", "--chip", 9]
    out = base.parent / "out"
    for name, keys in VARIANTS.items():
        if name == "rough":  # below
            continue
        folder = tmp_path / name
        folder.mkdir()
        alone = make(folder, {"itself": keys})
        data = yaml.safe_load(alone.read_text())
        del data["variants"]
        for key, value in keys.items():
            data[key] |= value
        alone.write_text(yaml.safe_dump(data | {"instrument": data["instrument"] | {
            "folder": str(base.parent / "instrument")}}))  # fmt: skip
        for kind in ("truth", "psf") if name == "warm" else ("truth",):
            shutil.copytree(out / kind, folder / "out" / kind)
        done("chip", alone, *job)
        (made,) = (out / "variants" / name / "level0").rglob("*.fits")
        (expected,) = (folder / "out" / "level0").rglob("*.fits")
        assert _level0(made) == _level0(expected)
        truth = "*.truth.parquet"
        assert _table(next(made.parent.glob(truth))) == _table(next(expected.parent.glob(truth)))
    (ours,), (theirs,) = ((root / "level0").rglob("*.fits") for root in (out, out / "variants" / "rough"))
    assert ours.read_bytes() == theirs.read_bytes() and not ours.samefile(theirs)  # only measured otherwise: a copy
    assert _level0(ours) != _level0(next((out / "variants" / "warm" / "level0").rglob("*.fits")))


def test_a_variant_has_every_file_that_its_base_wrote_beside_a_frame(tmp_path):
    """Its copies too: the image of cosmic rays, and the truth as text under both names of an earlier cycle's form."""
    layers = science(tmp_path, cosmic_rays={"save_cosmic_image": True})
    catalog = {"kind": "support.mini_campaign:Stars", "options": {"ra": [60.15], "dec": [-40.0], "mag": [20.0]}}
    given = {"observations": {"SCIE": str(layers)}, "level0_names": "C5.2", "truth": ["parquet", "cat"]}
    file = make(tmp_path, {"rough": VARIANTS["rough"]}, catalog=catalog, **given)
    for run in (file, f"{file}@rough"):
        said = done("chip", run, "--obsid", "10100000001", "--chip", 9)
    theirs, ours = (
        {path.name: path.read_bytes() for path in (tmp_path / "out" / folder).glob("level0/*/*")}
        for folder in ("", "variants/rough")
    )
    assert "equal in the base" in said and theirs == ours and len(ours) == 5
    assert {"MSC_10100000001_chip_09_filt_r.cat"} < set(ours)


def _level0(path):
    import fitsio

    from csstsim.studies.compare.varying import varies

    with fitsio.FITS(path) as file:
        records = [(r["name"], r["value"]) for hdu in file for r in hdu.read_header().records()]
        return [card for card in records if not varies(str(card[0]))], file["IMAGE"].read().tobytes()


def _table(path):
    from csstsim.catalog.table import ObjectTable

    table = ObjectTable.read(path)
    return {name: table[name].astype(str).tolist() for name in table.names if name != "ms"}


def test_one_graph_makes_each_thing_once(tmp_path):
    code, said = dry_run(make(tmp_path), "--cores", "1")
    assert code == 0, said
    jobs = dict(re.findall(r"^(\w+) +(\d+)$", said, re.MULTILINE))
    assert jobs["render"] == "1" and jobs["sparse_render"] == "1" and jobs["sparse_psf"] == "1"
    assert jobs["truth"] == "1" and jobs["warm_readout"] == "1" and jobs["rough_measure"] == "1"
    assert not {"warm_render", "warm_psf", "warm_truth", "rough_readout", "rough_render", "sparse_select"} & set(jobs)
    assert {"warm_report", "rough_report", "sparse_report", "report"} <= set(jobs)


def test_no_variants_no_other_jobs(tmp_path):
    with_none, without = (make(tmp_path / name, {}) for name in map(_folder(tmp_path), ("with", "without")))
    data = yaml.safe_load(without.read_text())
    del data["variants"]
    without.write_text(yaml.safe_dump(data))
    tables = [
        re.findall(r"^(\w+) +(\d+)$", dry_run(file, "--cores", "1")[1], re.MULTILINE) for file in (with_none, without)
    ]
    assert tables[0] == tables[1] and len(dict(tables[0])) == 13


def _folder(root):
    def made(name):
        (root / name).mkdir()
        return name

    return made


def test_the_plan_says_which_light_is_made_again(tmp_path):
    """A Level-0 file without light: it was finished without `keep: light`."""
    base = make(tmp_path)
    run = OpenCampaign(base)
    (job,) = run.jobs
    assert _rendered_again(run) == 0
    light, made = run.paths.stage(*job.key, RENDER_PRODUCTS[0]), run.paths.level0(job)
    for path in (light, made):
        path.parent.mkdir(parents=True)
    made.touch()
    assert _rendered_again(run) == 1 and "1 finished chip must be rendered again" in done("plan", base)
    light.touch()
    assert _rendered_again(run) == 0


def test_commands_know_the_variants(made):
    base = made
    assert "sparse" in done("plan", base) and "measurement.cti_passes: 1" in done("plan", base)
    assert done("check", base).count(": good; 1 chip") == 4
    kinds = wanted(OpenCampaign(base))
    assert "warm: Level-0 files" in kinds and "warm: PSF sets" not in kinds and "sparse: PSF sets" in kinds
    found = command("verify", base)
    assert "variants/warm:" in found.output and "foreign" not in found.output


@pytest.mark.parametrize(("variants", "said"), [
    ({"a": {"psf": {"grdi": 3}}}, r"@a: .*psf\.grdi"),
    ({"a": {"seeed": 3}}, "@a: .*seeed"),
    ({"a": {"psf": {"grid": 1}}}, r"@a: .*psf\.grid"),
    ({"a": {"output": "elsewhere"}}, r"variants\.a\.output.*cannot differ"),
    ({"a": {"variants": {}}}, "cannot differ"),
    ({"a b": {"seed": 4}}, "letters, digits"),
    ({"../a": {"seed": 4}}, "letters, digits"),
    ({"": {"seed": 4}}, "letters, digits"),
    ({"a": {}}, "equal to the base"),
    ({"a": {"seed": 3}}, "equal to the base"),
    ({"a": {"seed": 4}, "b": {"seed": 4}}, "equal to the variant a"),
    ({"a": 3}, r"variants\.a"),
    ([{"a": {"seed": 4}}], "variants"),
])  # fmt: skip
def test_a_fault_is_one_clear_error(tmp_path, variants, said):
    file = make(tmp_path, variants)
    with pytest.raises(InputError) as error:
        OpenCampaign(file)
    assert re.search(said, str(error.value)), error.value
    found = command("check", file)
    assert found.exit_code == 2 and len(found.output.splitlines()) <= 2 and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["nosuch", "warm@rough"])
def test_an_unknown_variant_is_refused(base, name):
    with pytest.raises(InputError, match="no such" if name == "nosuch" else "no file|cannot"):
        OpenCampaign(f"{base}@{name}")


def test_the_workflow_refuses_a_variant_without_its_base(base):
    code, said = dry_run(base.with_name("campaign.yaml@warm"), "--cores", "1")
    assert code == 2 and "without @" in said


def test_a_file_with_the_mark_in_its_name_is_a_base(tmp_path):
    file = make(tmp_path, {"a": {"seed": 4}}).rename(tmp_path / "mine@home.yaml")
    assert OpenCampaign(file).variant is None and OpenCampaign(f"{file}@a").config.seed == 4


def test_keys_of_a_variant_replace_those_of_the_base_one_by_one():
    data = {
        "name": "a", "psf": {"grid": 2, "beta": 3}, "window": {"x0": 1}, "seed": 4,
        "variants": {"v": {"psf": {"grid": 5}, "window": "region", "seed": 0}, "w": None},
    }  # fmt: skip
    assert variants.variant_data(data, "v", "a.yaml") == {
        "name": "a", "psf": {"grid": 5, "beta": 3}, "window": "region", "seed": 0,
    }  # fmt: skip
    assert variants.variant_data(data, "w", "a.yaml") == {k: v for k, v in data.items() if k != "variants"}
    assert data["psf"] == {"grid": 2, "beta": 3}
    with pytest.raises(InputError, match=r"no such variant \(got 'x'\); allowed: v, w"):
        variants.variant_data(data, "x", "a.yaml")
    for key in variants.OF_BASE:
        with pytest.raises(InputError, match=rf"variants\.v\.{key}: cannot differ"):
            variants.variant_data({"variants": {"v": {key: 1}}}, "v", "a.yaml")


def pair(**given):
    """Return a made-up variant and its base, of equal keys but for those given of the variant."""

    def opened(**own):
        keys = {"level0_names": "C9", "truth": ("parquet",), "survey_table": "t", "select": "s", "window": None}
        keys["measurement"] = SimpleNamespace(joint=own.pop("joint", False))
        recipes = {name: own.pop(name, "same") for name in ("truth_recipe", "psf_recipe")}
        digest, made = own.pop("camera", "c"), own.pop("recipe", "made")
        camera = SimpleNamespace(digest_for=lambda stage: f"{stage} {digest}")
        return SimpleNamespace(
            config=SimpleNamespace(**(keys | own)), camera=camera, sky_bricks=[7], sky_chips=[9],
            recipes=SimpleNamespace(truth=recipes["truth_recipe"], psf=recipes["psf_recipe"]),
            job=lambda obsid, chip: _job(obsid, chip), recipe=lambda job, stage: (job, stage, made),
        )  # fmt: skip

    base, run = opened(), opened(**given)
    run.base, run.variant = base, "v"
    base.paths = Paths("/out")
    return run


def _job(obsid, chip):
    if chip == 8:
        raise InputError("not one of its jobs")
    return obsid, chip


@pytest.mark.parametrize(("given", "stages"), [
    ({}, ("select", "render", "level0", "measure")), ({"recipe": "otherwise"}, ()),
    ({"joint": True}, ("select", "render", "level0")),
    ({"level0_names": "C3"}, ("select", "render")), ({"truth": ("parquet", "cat")}, ("select", "render")),
])  # fmt: skip
def test_products_are_equal_by_their_recipe_and_frames_by_their_names_too(given, stages):
    run = pair(**given)
    found = [s for s in ("select", "render", "level0", "measure") if variants.same_product(run, "1", 9, s)]
    assert tuple(found) == stages
    assert not variants.same_product(run, "1", 8, "render")


def test_rules_of_which_nothing_is_left_are_those_whose_stage_is_equal():
    run, asked = pair(), []
    equal = {"select", "level0"}
    run.in_base = lambda obsid, chip, stage: asked.append((obsid, chip)) or stage in equal
    found = {rule for rule in (
        "select", "render", "readout", "level0", "chip", "measure", "extract", "calibrate", "merge", "masters",
    ) if variants.made_by_base(run, rule, ("1", 9))}  # fmt: skip
    assert found == {"select", "readout", "level0", "chip"} and set(asked) == {("1", 9)}
    equal |= {"measure"}
    assert variants.made_by_base(run, "extract", ("1", 9)) and not variants.made_by_base(run, "calibrate", ("1", 9))
    run.paths = Paths("/out/variants/v")
    run.paths.find = lambda name, chip: Path("/out/psf") if chip == "09" else Path("/out/variants/v/psf")
    assert variants.made_by_base(run, "psf", 9) and not variants.made_by_base(run, "psf", 8)
    run.base = None
    assert not any(variants.made_by_base(run, rule, ("1", 9)) for rule in ("select", "psf"))


@pytest.mark.parametrize(("given", "bricks", "chips"), [
    ({}, {7, 8}, {8, 9}), ({"select": "other"}, {7}, {9}), ({"window": "region"}, {7}, {9}),
    ({"survey_table": "u"}, {7}, {9}), ({"camera": "d"}, {7}, {9}), ({"truth_recipe": "other"}, set(), {8, 9}),
    ({"psf_recipe": "other"}, {7, 8}, set()), ({"select": "other", "psf_recipe": "other"}, {7}, set()),
])  # fmt: skip
def test_bricks_and_sets_are_the_bases_if_it_makes_them_and_they_are_equal(given, bricks, chips):
    """The base has brick 7 and chip 9; of an equal selection it has all that the variant needs."""
    run = pair(**given)
    run.in_base = lambda obsid, chip, stage: stage == "render"
    paths = variants.VariantPaths(run, "/out", "/disk")
    own = Path("/out/variants/v")
    assert paths.output == own and paths.chips == Path("/disk/variants/v/chips")
    assert {pix for pix in (7, 8) if paths.truth(pix) == Paths("/out").truth(pix)} == bricks
    assert all(paths.truth(pix) == Paths(own).truth(pix) for pix in {7, 8} - bricks)
    for name in ("psf", "psf_tables"):
        theirs, ours = getattr(Paths("/out"), name), getattr(Paths(own), name)
        assert {chip for chip in (8, 9) if getattr(paths, name)(chip) == theirs(chip)} == chips
        assert all(getattr(paths, name)(chip) == ours(chip) for chip in {8, 9} - chips)
    assert all(paths.stage("1", 9, name) == Paths("/out").stage("1", 9, name) for name in RENDER_PRODUCTS)
    assert paths.stage("1", 9, "select.parquet") == Path("/disk/variants/v/chips/1_09/select.parquet")
    assert paths.stage("1", 9, "readout.fits") == Path("/disk/variants/v/chips/1_09/readout.fits")


def test_the_name_of_a_variant_stands_behind_the_mark(tmp_path):
    assert variants.split_name("a/c.yaml@v") == (Path("a/c.yaml"), "v")
    assert variants.variant_file("a/c.yaml", "v") == Path("a/c.yaml@v")
    for name in ("a/c.yaml", "a/@v", "a/c.yaml@"):
        assert variants.split_name(name) == (Path(name), None)
    assert variants.split_name("a@b/c.yaml@w@v") == (Path("a@b/c.yaml@w"), "v")
    (tmp_path / "c@v").touch()
    assert variants.split_name(tmp_path / "c@v") == (tmp_path / "c@v", None)
