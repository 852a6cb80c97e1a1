"""A pack: what is public and what is not, the same twice, its positions, and its score."""

import csv
import hashlib
import json
import shutil

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from support.commands import done, refused

from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.studies.compare.compare import compare
from csstsim.studies.release import pack as pack_module
from csstsim.studies.release.pack_readme import readme
from release.crates import checked, validated

ALLOWED = {"MANIFEST.sha256", "MANIFEST.tsv", "ro-crate-metadata.json"}  # what a crate cannot have hashes of


def objects(folder):
    return ObjectTable.read(folder / "truth" / "objects.parquet")


def test_two_packs_are_the_same_but_for_dates(packs):
    said = []
    assert compare(*packs, said.append) == 0, said


def test_checksums_are_those_of_all_files(packs):
    for part in ("public", "truth"):
        folder = packs[0] / part
        lines = (folder / "MANIFEST.sha256").read_text().splitlines()
        listed = dict(reversed(line.split("  ")) for line in lines)
        there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
        assert set(listed) == there - {"MANIFEST.sha256"}
        for name, digest in listed.items():
            assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


def test_nothing_public_has_the_seed_or_the_truth(packs, sound):
    seed = OpenCampaign(sound[0]).config.seed
    names = {path.name for path in (packs[0] / "public").rglob("*")}
    assert not any("truth" in name or "orders" in name or name == "campaign.yaml" for name in names)
    for path in (packs[0] / "public").rglob("*.fits"):
        with fits.open(path) as file:
            secret = {"SIMSEED", "CAMPHASH", "TRUTHASH"}
            assert not any(secret & set(hdu.header) for hdu in file)
    assert f'"seed": {seed}' in (packs[0] / "truth" / "workflow" / "recipes.json").read_text()


def test_the_objects_have_the_columns_of_the_schema(packs):
    dtypes = json.loads((packs[0] / "truth" / "workflow" / "tables.json").read_text())["tables"]["pack"]["schema"][
        "fields"
    ]
    dtypes = {field["name"]: field["dtype"] for field in dtypes}
    table = objects(packs[0])
    assert {name: table[name].dtype.name for name in table} == {name: dtypes[name] for name in table}
    assert {"id", "ra", "dec", "obj_type", "z", "size", "e1", "e2", "mag_r", "snr_r", "n_r"} <= set(table)


def test_frames_as_read_are_the_level0_files(packs, sound):
    [path] = (packs[0] / "public" / "raw").glob("*_09_r.fits")
    [level0] = sound[1].glob("level0/*/*_WIDE_*_09_L0_V01.fits")
    with fits.open(path) as packed, fits.open(level0) as original:
        assert np.array_equal(packed["IMAGE"].data, original["IMAGE"].data)
        assert path.stat().st_size < level0.stat().st_size


def test_the_table_of_frames(packs):
    with (packs[0] / "public" / "frames.csv").open() as file:
        image, spectra = sorted(csv.DictReader(file), key=lambda row: row["kind"])
    assert (image["filter"], image["kind"], spectra["filter"], spectra["kind"]) == ("r", "imaging", "GV", "slitless")
    assert image["psf"] and not spectra["psf"] and int(image["psf_stars"]) > 5
    for row in (image, spectra):
        assert (packs[0] / "public" / row["calibrated"]).is_file() and (packs[0] / "public" / row["raw"]).is_file()
    assert {"GV5.conf", "GV6.conf", "GV_p1.fits", "chips.csv"} <= {
        path.name for path in (packs[0] / "public" / "gratings").iterdir()
    }


def test_stars_lie_where_the_header_says(packs):
    """The truth's ICRS positions, through astropy's TPV, on the brightest pixels: all 25 stars, within a pixel."""
    [path] = (packs[0] / "public" / "calibrated").glob("*_09_r.fits")
    table = objects(packs[0])
    with fits.open(path) as file:
        x, y = WCS(file["SCI"].header).all_world2pix(table["ra"], table["dec"], 0)
        image = file["SCI"].data
        assert file["SCI"].header["MAGZERO"] > 20 and file["DQ"].data.dtype == np.uint8
    assert len(table) == 25
    for one, other in zip(x, y, strict=True):
        part = image[round(other) - 3 : round(other) + 4, round(one) - 3 : round(one) + 4]
        row, column = np.unravel_index(part.argmax(), part.shape)
        assert abs(row - 3) <= 1 and abs(column - 3) <= 1


def test_the_truth_of_a_pack_scores_as_perfect_by_the_command(packs, tmp_path):
    table = objects(packs[0])
    Table({"RA": table["ra"], "DEC": table["dec"], "R": table["mag_r"]}).write(tmp_path / "mine.csv")
    said = done(
        "release", "score", tmp_path / "mine.csv", "--truth", packs[0] / "truth", "--output", tmp_path / "score",
        "--map", "mag_r=R",
    )  # fmt: skip
    made = json.loads((tmp_path / "score" / "score.json").read_text())
    assert made["completeness"]["all"]["completeness"] == 1.0 == made["purity"]["purity"]
    assert made["photometry"]["r"]["points"]["mean"] == pytest.approx(0, abs=1e-6)
    assert "purity: 1.000" in said and "no column is mapped as z" in said
    page = (tmp_path / "score" / "score.html").read_text()
    assert page.count("data:image/webp") == 4 and "http" not in page.split("</head>")[1]


def test_what_is_not_finished_or_not_empty_is_refused(packs, sound, tmp_path):
    assert "not empty" in refused("release", "pack", sound[0], "--output", packs[0])
    copy = shutil.copytree(sound[0].parent, tmp_path / "unfinished")
    next((copy / "out" / "measure").glob("*.parquet")).unlink()
    text = (copy / "campaign.yaml").read_text().replace(str(sound[0].parent), str(copy))
    (copy / "campaign.yaml").write_text(text)
    (copy / "out" / "campaign.json").unlink(missing_ok=True)
    assert "finish the campaign" in refused("release", "pack", copy / "campaign.yaml", "--output", tmp_path / "pack")
    assert not (tmp_path / "pack").exists()
    assert "unknown licence" in refused("release", "pack", sound[0], "--output", tmp_path / "p", "--licence", "free")
    assert "not the truth of a pack" in refused(
        "release", "score", "none.csv", "--truth", tmp_path, "--output", tmp_path / "score"
    )


def test_a_pack_that_fails_leaves_nothing(sound, tmp_path, monkeypatch):
    """The second frame is damaged: the first one has been written by then."""
    copy = shutil.copytree(sound[0].parent, tmp_path / "damaged")
    (copy / "campaign.yaml").write_text((copy / "campaign.yaml").read_text().replace(str(sound[0].parent), str(copy)))
    (copy / "out" / "campaign.json").unlink(missing_ok=True)
    run, written = OpenCampaign(copy / "campaign.yaml"), []
    last = run.paths.level0([job for job in run.jobs if job.pointing.type == "SCIE"][-1])
    last.write_bytes(last.read_bytes()[:4000])
    frame = pack_module.write_frame
    monkeypatch.setattr(pack_module, "write_frame", lambda *given: written.append(frame(*given)) or written[-1])
    with pytest.raises(InputError, match=last.name):
        pack_module.pack(run, tmp_path / "pack", print)
    assert len(written) == 1 and not list((tmp_path / "pack").iterdir())


def test_missing_files_of_csstsim_are_reported_before_the_first_frame(sound, tmp_path, monkeypatch):
    monkeypatch.setattr(pack_module, "ROOT", tmp_path)
    monkeypatch.setattr(pack_module, "write_frame", lambda *given: pytest.fail("a frame was written"))
    with pytest.raises(FileNotFoundError, match="CITATION"):
        pack_module.pack(OpenCampaign(sound[0]), tmp_path / "pack", print)
    assert not list((tmp_path / "pack").iterdir())


def test_crates_of_a_pack(packs):
    public, left = checked(packs[0] / "public")
    assert left <= ALLOWED and public["#A.%20N.%20Other"]["name"] == "A. N. Other"
    assert "CITATION.cff" in public and not any("workflow" in name for name in public)
    truth, left = checked(packs[0] / "truth")
    assert left <= ALLOWED and "workflow/inputs/campaign.yaml" in truth


@pytest.mark.parametrize("part", ["public", "truth"])
def test_crates_of_a_pack_by_the_validator(packs, part):
    validated(packs[0] / part, "ro-crate-1.1")


def test_the_readme_tells_what_there_is(packs):
    text = (packs[0] / "public" / "README.md").read_text()
    assert "images in r (1); spectroscopic frames in GV (1)" in text and "$" not in text
    assert "B is r: `mag_r`" in text
    for name in ("frames.csv", "filters.csv", "CITATION.cff", "MANIFEST.sha256"):
        assert name in text and (packs[0] / "public" / name).is_file()


def test_the_readme_names_the_bands_of_the_images():
    image = {"name": "a", "kind": "imaging", "zero_point_mag": 25.0, "psf": None, "psf_fwhm_px": None}
    spectra = image | {"kind": "slitless", "filter": "GV"}
    text = readme("field", [image | {"filter": band} for band in ("NUV", "r", "y", "r")] + [spectra], "CC-BY-4.0")
    assert "B is nuv, r or y: `mag_r`" in text


@pytest.mark.parametrize("kind, psf", [("imaging", "psf/a.psf"), ("imaging", None), ("slitless", None)])
def test_the_readme_leaves_out_what_there_is_not(kind, psf):
    image = {
        "name": "a",
        "kind": "imaging",
        "filter": "r",
        "zero_point_mag": 25.0,
        "psf": psf,
        "psf_fwhm_px": psf and 2.0,
    }
    text = readme("field", [image] + [image | {"kind": kind}] * (kind != "imaging"), "CC-BY-4.0")
    assert all((word in text) == bool(psf) for word in ("psf/", "PSF_NAME", "psf_fwhm_px", "SEEING_FWHM"))
    assert ("gratings/" in text) == (kind == "slitless") == ("**Spectroscopic frames**" in text)
    assert "MAGZERO" in text and "B is r: `mag_r`" in text and "$" not in text and "\n\n\n" not in text
