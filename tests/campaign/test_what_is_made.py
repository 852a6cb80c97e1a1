"""The kinds of products of a campaign, and what the workflow says of them at its end (campaign.products)."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from csstsim.campaign import products
from csstsim.campaign.products import MAX_GATES, ProductKind, kinds, pairs_of_base, summary
from csstsim.io.paths import Paths


def job(obsid, number, spectra=False, kind="SCIE"):
    chip = SimpleNamespace(id=number, filter="GI" if spectra else "r", label=f"{number:02d}")
    return SimpleNamespace(
        obsid=obsid, chip=chip, key=(obsid, number), spectra=spectra, pointing=SimpleNamespace(type=kind)
    )


SKY, SPECTRUM, BIAS = job("1", 9), job("1", 21, spectra=True), job("3", 9, kind="BIAS")


class Named(Paths):
    """Paths whose Level-0 files have short names."""

    def stem(self, job):
        return f"{job.obsid}_{job.chip.id}"


def opened(
    folder,
    *,
    keep="nothing",
    truth=("parquet",),
    calibrated=False,
    variants=(),
    in_base=(),
    bricks=(7, 30),
    joint=False,
):
    """Return what products reads of an OpenCampaign of an imaging frame, a slitless one and a bias."""
    measurement = SimpleNamespace(keep_calibrated=calibrated, joint=joint)
    return SimpleNamespace(
        title="mine", paths=Named(folder), jobs=(SKY, SPECTRUM, BIAS), science_jobs=(SKY, SPECTRUM), base=None,
        config=SimpleNamespace(keep=keep, truth=truth, measurement=measurement), imaging_jobs=(SKY,),
        slitless_jobs=(SPECTRUM,), sky_bricks=[7, 8], sky_chips=[9, 21], merge_bricks={pix: [SKY] for pix in bricks},
        calibration_jobs={9: [BIAS]}, variants=variants, has_orders=lambda job: job.spectra,
        has_stage=lambda pointing, stage: pointing.type == "SCIE", in_base=lambda *key: key in in_base,
        calibrated_jobs=(SKY,) if calibrated else (), reports=[None], comparisons=[None] if variants else [],
    )  # fmt: skip


def names(run, rule):
    kind = kinds(run)[rule]
    return [path.relative_to(run.paths.output).as_posix() for one in kind.made_for for path in kind.files_of(one)]


HATS = "dataset/Norder=8/Dir=0/Npix"


def test_each_kind_has_its_files_the_product_first(tmp_path):
    run = opened(tmp_path)
    assert {rule: names(run, rule) for rule in kinds(run)} == {
        "truth": [f"truth/{HATS}=7.parquet", f"truth/{HATS}=8.parquet"],
        "psf": ["psf/chip_09.h5", "psf/chip_09_tables.h5", "psf/chip_21.h5", "psf/chip_21_tables.h5"],
        "render": [],
        "level0": [
            "level0/1/1_9.fits", "level0/1/1_9.truth.parquet", "level0/1/1_21.fits", "level0/1/1_21.truth.parquet",
            "level0/1/1_21.orders.parquet", "level0/3/3_9.fits", "level0/3/3_9.truth.parquet",
        ],
        "masters": ["masters/chip_09.fits"], "calibrate": [], "measure": ["measure/1_09.parquet"],
        "extract": ["spectra/1_21.parquet", "spectra/1_21.png", "spectra/1_21_lines.parquet"],
        "merge": [f"merge/{HATS}=7.parquet", f"merge/{HATS}=30.parquet"],
        "validate": ["validate/7.json", "validate/7.png", "validate/30.json", "validate/30.png"],
        "report": ["report/index.html", "report/verdict.json", *(f"merge/{name}" for name in products.ABOUT)],
        "variants": [],
    }  # fmt: skip
    assert [rule for rule, kind in kinds(run).items() if not kind.target] == ["truth", "psf"]
    assert kinds(run)["level0"].rules == ("select", "render", "readout", "level0")
    assert kinds(run)["measure"].files([SKY]) == [str(tmp_path / "measure/1_09.parquet")]
    assert kinds(run)["merge"].files() == [str(tmp_path / f"merge/{HATS}={pix}.parquet") for pix in (7, 30)]


def test_what_the_campaign_file_asks_for_is_made(tmp_path):
    run = opened(tmp_path, keep="light", truth=("parquet", "cat"), calibrated=True, variants=(1,), bricks=())
    assert names(run, "render") == [
        "chips/1_09/render.fits", "chips/1_09/drawn.parquet", "chips/1_21/render.fits", "chips/1_21/drawn.parquet",
        "chips/1_21/orders.parquet",
    ]  # fmt: skip
    found = kinds(run)
    assert found["level0"].rules == ("readout", "level0") and found["render"].rules == ("select", "render")
    assert names(run, "level0")[:3] == ["level0/1/1_9.fits", "level0/1/1_9.truth.parquet", "level0/1/1_9.cat"]
    assert names(run, "level0")[3:7] == [
        f"level0/1/1_21{end}" for end in (".fits", ".truth.parquet", ".cat", ".orders.parquet")
    ]
    left = opened(tmp_path, joint=True)
    assert names(left, "measure") == ["measure/1_09.parquet", "measure/1_09.residual.fits"]
    assert names(run, "calibrate") == ["calibrated/1_09.fits"] and names(run, "variants") == ["report/variants.html"]
    assert names(run, "report") == ["report/index.html", "report/verdict.json"]
    light = opened(tmp_path, keep="light", in_base=[("1", 9, "render")])
    light.base = opened(tmp_path, keep="light")
    assert kinds(light)["render"].made_for == [SPECTRUM]


def test_the_base_of_a_variant_has_the_bricks_and_sets_that_it_makes(tmp_path, monkeypatch):
    of_base = ("truth", 7), ("psf", 21)
    monkeypatch.setattr(products, "made_by_base", lambda run, rule, number: (rule, number) in of_base)
    found = kinds(opened(tmp_path))
    assert found["truth"].made_for == [8] and found["psf"].made_for == [9] and len(found["level0"].made_for) == 3


def touch(*paths):
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_a_variant_takes_all_files_of_a_job_or_none(tmp_path):
    run, base = opened(tmp_path / "v"), opened(tmp_path)
    run.base = base
    theirs = [base.paths.level0(SKY), base.paths.level0_truth(SKY)]
    touch(theirs[0])
    assert pairs_of_base(run, SKY, "level0") == []
    touch(theirs[1])
    pairs = [(path, tmp_path / "v" / path.relative_to(tmp_path)) for path in theirs]
    assert pairs_of_base(run, SKY, "level0") == pairs
    rays = base.paths.level0_cosmic(SKY)
    touch(rays)
    assert pairs_of_base(run, SKY, "level0") == [*pairs, (rays, tmp_path / "v" / rays.relative_to(tmp_path))]
    touch(base.paths.measure(*SKY.key))
    assert pairs_of_base(run, SKY, "measure") == [(base.paths.measure("1", 9), run.paths.measure("1", 9))]


def gates(*passed):
    return [{"name": f"gate {k}", "passed": one} for k, one in enumerate(passed)]


def test_the_last_message_counts_what_was_made_and_says_which_gates_fail(tmp_path, monkeypatch):
    monkeypatch.setattr(products, "headline", lambda verdict: f"HEAD {len(verdict['gates'])}")
    monkeypatch.setattr(products, "sentence", lambda gate: gate["name"])
    run = opened(tmp_path)
    said = [
        "", f"mine, in {tmp_path}:", "  3 Level-0 files with truth in level0/", "  masters of 1 chip in masters/",
        "  spectra of 1 chip in spectra/", "  merged catalogues of 2 bricks in merge/",
        "  the report: report/index.html",
    ]  # fmt: skip
    assert summary(run, kinds(run)).split("\n") == said
    run.paths.report.parent.mkdir()
    verdict = run.paths.report.with_name("verdict.json")
    verdict.write_text(json.dumps({"gates": gates(True, False, None, False)}))
    assert summary(run, kinds(run)).split("\n") == [*said, "HEAD 4", "  gate 1", "  gate 3"]
    for count, more in ((MAX_GATES, []), (MAX_GATES + 2, ["  ... and 2 more, in the report"])):
        verdict.write_text(json.dumps({"gates": gates(*[False] * count)}))
        last = summary(run, kinds(run)).split("\n")[len(said) :]
        assert last == [f"HEAD {count}", *(f"  gate {k}" for k in range(MAX_GATES)), *more]
    assert MAX_GATES == 10
    alone = opened(tmp_path, bricks=(), calibrated=True)
    assert "HEAD" not in summary(alone, kinds(alone)) and "calibrated images of 1 chip in" in summary(
        alone, kinds(alone)
    )
    alone.science_jobs, alone.reports = (), []
    assert "3 Level-0 files in level0/" in summary(alone, kinds(alone)) and "report" not in summary(alone, kinds(alone))


def test_a_kind_is_looked_up_when_asked():
    asked = []
    kind = ProductKind("frames", ("a", "b"), lambda: asked.append(1) or "xy", lambda one: [Path(one), Path(one * 2)])
    assert not asked and kind.files("z") == ["z", "zz"] and not asked
    assert kind.files() == ["x", "xx", "y", "yy"] and kind.target and kind.summary == ""
    with pytest.raises(AttributeError):
        kind.made_for = ()
