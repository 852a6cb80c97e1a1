"""What a campaign's folder should hold, of three jobs made up here: each field, and the list of products with needs."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from csstsim.base.digest import digest
from csstsim.catalog.table import ObjectTable
from csstsim.delivery import contents as contents_module
from csstsim.delivery.contents import MAYBE, NO, YES, Contents, ExpectedFrame, of_campaign
from csstsim.delivery.products import Product, products
from csstsim.instrument.chip import Window
from csstsim.io.paths import Paths
from csstsim.io.pointing_keywords import Boresight
from csstsim.measure.bricks.hats import ABOUT

FOLDER = Path("/out")


class Named(Paths):
    """Paths whose Level-0 files have short names, and the text of C3 a name of its own."""

    def level0(self, job):
        return self.output / "level0" / f"{job.obsid}_{job.chip.id}.fits"

    def level0_catalogue(self, job):
        return self.output / "level0" / f"MSC_{job.obsid}_{job.chip.id}.cat"


def job(obsid, number, name="r", kind="SCIE"):
    return SimpleNamespace(
        obsid=obsid, key=(obsid, number), chip=SimpleNamespace(id=number, filter=name), wcs=f"WCS {number}",
        pointing=SimpleNamespace(type=kind, ra=10.0, dec=-20.0, pa=30.0), window=Window(1, 20, 3, 40),
    )  # fmt: skip


SKY, SPECTRUM, BIAS = job("1", 9), job("1", 21, "GI"), job("3", 9, kind="BIAS")


def opened(monkeypatch, saves=None, truth=("parquet",), joint=False, **empty):
    """Return a made-up OpenCampaign of an image, a spectrum and a bias; saves: of the science layer of rays."""
    monkeypatch.setattr("csstsim.catalog.truth_bricks.brick_meta", lambda pix, **key: (pix, key))
    monkeypatch.setattr("csstsim.stages.masters.masters_recipe", lambda run, chip: f"masters {chip}")
    made = {
        "truth": [7, 8], "render": [SKY], "level0": [SKY, SPECTRUM, BIAS], "masters": [9], "calibrate": [SKY],
        "measure": [SKY], "extract": [SPECTRUM], "merge": [5], "report": [None],
    } | empty  # fmt: skip
    light = lambda job: [f"light {job.obsid}"]  # noqa: E731
    kinds = {rule: SimpleNamespace(name=rule, made_for=some, files_of=light) for rule, some in made.items()}
    monkeypatch.setattr(contents_module, "kinds", lambda run: kinds)
    rays = None if saves is None else SimpleNamespace(param=SimpleNamespace(save_cosmic_image=saves))
    steps = {"SCIE": SimpleNamespace(step={"cosmic_rays": rays}.get), "BIAS": SimpleNamespace(step=lambda name: None)}
    return SimpleNamespace(
        paths=Named(FOLDER), steps=steps, recipe=lambda job, stage="level0": {"of": stage, "job": job.key},
        brick_recipe=lambda pix: f"brick {pix}", universe_key=lambda: {"seed": 3}, measurement={"passes": 3},
        config=SimpleNamespace(truth=truth, measurement=SimpleNamespace(joint=joint)),
    )  # fmt: skip


def test_the_fields_of_a_campaigns_contents(monkeypatch):
    found = of_campaign(opened(monkeypatch, saves=True))
    assert found.bricks == {5: "brick 5"} and found.truth == {7: (7, {"seed": 3}), 8: (8, {"seed": 3})}
    assert found.masters == {9: "masters 9"} and found.light == {"light 1": {"of": "render", "job": ("1", 9)}}
    assert found.measurement == digest({"passes": 3}) and found.faults == []
    assert (found.calibrated, found.joint, found.report, found.cat) == (YES, MAYBE, YES, NO)
    assert of_campaign(opened(monkeypatch, joint=True)).joint == YES
    none = of_campaign(opened(monkeypatch, truth=("parquet", "cat"), calibrate=[], report=[]))
    assert (none.calibrated, none.report, none.cat) == (MAYBE, MAYBE, YES)
    assert found.others == {}
    more = of_campaign(opened(monkeypatch, stack=[SKY]))
    assert more.others == {"light 1": "stack"} and products(more)[-1] == Product("stack", "light 1", YES, None)


@pytest.mark.parametrize(("saves", "cosmic"), [(True, YES), (False, NO), (None, NO)])
def test_the_fields_of_its_frames(monkeypatch, saves, cosmic):
    image, spectrum, bias = of_campaign(opened(monkeypatch, saves)).frames
    assert image == ExpectedFrame(
        "1", 9, "r", "SCIE", FOLDER / "level0/1_9.fits", {"of": "level0", "job": ("1", 9)},
        {"of": "readout", "job": ("1", 9)}, (1, 20, 3, 40), YES, NO, cosmic, Boresight(10.0, -20.0, 30.0), "WCS 9",
    )  # fmt: skip
    assert (spectrum.measured, spectrum.extracted, spectrum.filter) == (NO, YES, "GI")
    assert (bias.measured, bias.extracted, bias.cosmic, bias.type) == (NO, NO, NO, "BIAS")
    assert image.companion(".orders.parquet") == FOLDER / "level0/1_9.orders.parquet" and image.key == ("1", 9)
    with_text = of_campaign(opened(monkeypatch, truth=("parquet", "cat"))).frames
    assert with_text[0].catalogue == FOLDER / "level0/MSC_1_9.cat"


def test_sets_are_those_of_chips_that_see_the_sky_and_measurements_hang_on_their_way(monkeypatch):
    found = of_campaign(opened(monkeypatch))
    later = ExpectedFrame("0", 9, "r", "SCIE", Path("x"), None, None, None, YES, NO, NO)
    both = Contents(found.paths, (*found.frames, later), {}, {}, {}, {}, "way", MAYBE, MAYBE, MAYBE, NO)
    assert {chip: frame.obsid for chip, frame in both.psf.items()} == {9: "1", 21: "1"} and list(both.psf) == [9, 21]
    assert both.measure_recipe(found.frames[0]) == {"of": "level0", "job": ("1", 9), "measurement": "way"}
    assert both.measure_recipe(later) is None
    unknown = Contents(found.paths, found.frames, {}, {}, {}, {}, None, MAYBE, MAYBE, MAYBE, NO)
    assert unknown.measure_recipe(found.frames[0]) is None


def listed(contents):
    """Return {path: (kind, need, has a check, what must be beside it)} of products; all paths differ."""
    found = products(contents)
    table = {
        p.path.relative_to(FOLDER).as_posix(): (
            p.kind, p.need, p.check is not None, tuple(one.relative_to(FOLDER).as_posix() for one in p.requires)
        )
        for p in found
    }  # fmt: skip
    assert len(table) == len(found)
    return table


def test_every_product_of_a_campaign_is_looked_for_where_it_lies(monkeypatch):
    run = opened(monkeypatch, saves=False, render=[])
    brick = "dataset/Norder=8/Dir=0/Npix"
    assert listed(of_campaign(run)) == {
        "level0/1_9.fits": ("Level-0", YES, True, ()), "level0/1_9.truth.parquet": ("truth", YES, True, ()),
        "calibrated/1_09.fits": ("calibrated", YES, True, ()), "measure/1_09.parquet": ("measured", YES, True, ()),
        "measure/1_09.residual.fits": ("residual", MAYBE, True, ()),
        "level0/1_21.fits": ("Level-0", YES, True, ()), "level0/1_21.truth.parquet": ("truth", YES, True, ()),
        "level0/1_21.orders.parquet": ("truth of orders", YES, True, ()),
        "spectra/1_21.parquet": ("spectra", YES, True, ()),
        "spectra/1_21_lines.parquet": ("line fluxes", YES, True, ()),
        "spectra/1_21.png": ("figure of spectra", YES, True, ()), "level0/3_9.fits": ("Level-0", YES, True, ()),
        "level0/3_9.truth.parquet": ("truth", YES, True, ()), "masters/chip_09.fits": ("masters", YES, True, ()),
        "psf/chip_09.h5": ("PSF set", YES, True, ()),
        "psf/chip_09_tables.h5": ("PSF tables", YES, True, ("psf/chip_09.h5",)),
        "psf/chip_21.h5": ("PSF set", YES, True, ()),
        "psf/chip_21_tables.h5": ("PSF tables", YES, True, ("psf/chip_21.h5",)),
        f"truth/{brick}=7.parquet": ("truth brick", YES, True, ()),
        f"truth/{brick}=8.parquet": ("truth brick", YES, True, ()),
        **{f"truth/{name}": ("truth catalogue", MAYBE, name.endswith(".csv"), ()) for name in ABOUT},
        f"merge/{brick}=5.parquet": ("merged brick", YES, True, ()),
        "merge/partition_info.csv": ("merged catalogue", YES, True, ()),
        "merge/dataset/_metadata": ("merged catalogue", YES, False, ()),
        "merge/dataset/_common_metadata": ("merged catalogue", YES, False, ()),
        "merge/hats.properties": (
            "merged catalogue", YES, True, ("merge/dataset/_metadata", "merge/dataset/_common_metadata"),
        ),
        "validate/5.json": ("validation", YES, True, ()), "validate/5.png": ("figure of validation", YES, True, ()),
        "report/index.html": ("report", YES, True, ()), "report/verdict.json": ("verdict", YES, True, ()),
        "report/variants.html": ("comparison of variants", MAYBE, True, ()),
    }  # fmt: skip


def test_each_check_knows_the_recipe_of_its_file(monkeypatch, tmp_path):
    """Tables that record another one are named, whatever else they hold; of light those of its own stage."""
    contents = of_campaign(opened(monkeypatch, saves=False))
    light, theirs = tmp_path / "drawn.parquet", {"recipe": {"of": "another campaign"}}
    contents = replace(contents, paths=Named(tmp_path), light={light: {"of": "render"}})
    kinds = "light of a chip", "merged brick", "validation", "measured", "spectra", "line fluxes"
    for product in products(contents):
        if product.kind not in kinds:
            continue
        product.path.parent.mkdir(parents=True, exist_ok=True)
        if product.kind == "validation":
            product.path.write_text(json.dumps({"brick": 5, "gates": [], **theirs}))
        else:
            ObjectTable({"id": [1]}).write(product.path, theirs)
        assert next(iter(product.check())).startswith("made for another campaign: "), product.kind
    ObjectTable({"id": [1]}).write(light, {"recipe": {"of": "render"}})
    [of_light] = [product for product in products(contents) if product.kind == "light of a chip"]
    assert list(of_light.check()) == []


def test_what_a_campaign_asks_for_in_addition_is_looked_for(monkeypatch):
    run = opened(monkeypatch, saves=True, truth=("parquet", "cat"), merge=[], report=[], calibrate=[])
    found = listed(replace(of_campaign(run), light={FOLDER / "chips/a.fits": None}))
    beside = ("level0/1_9.truth.parquet",)
    assert found["level0/1_9.cat"] == found["level0/MSC_1_9.cat"] == ("truth as text", YES, True, beside)
    assert found["level0/1_9.cosmic.fits"] == ("cosmic rays", YES, True, ())
    assert found["chips/a.fits"] == ("light of a chip", YES, True, ())
    assert found["calibrated/1_09.fits"][1] == MAYBE and found["report/index.html"][1] == MAYBE
    assert "calibrated/1_21.fits" not in found and not any(name.startswith("merge/") for name in found)
