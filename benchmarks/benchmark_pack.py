"""A public benchmark packed, and a catalogue of it made and scored by the pack's README alone.

    python benchmarks/benchmark_pack.py    # ten CPU-minutes

The campaign of config/benchmark_pack.yaml is made and packed. The columns and the commands of source-extractor are read
from the README's own blocks, and run in the folder that a stranger gets; so is the command that scores the catalogue.
Then MAG_PSF is measured, as the README says how. The traces of bright sources' spectra are computed by the README's
formula. The campaign's merged catalogue is scored, too. Needs `apt-get install source-extractor`.
"""

import argparse
import csv
import json
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

from evidence import ROOT
from evidence.record import Record, cpu_seconds

import numpy as np
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from campaign_gates import made
from delivery.small_delivery import delivery

from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.running.run_times import run_times
from csstsim.studies.release.pack import pack
from csstsim.studies.release.score.score import score

LEAST, MOST = 0.9, 0.25  # of points of S/N above 10; mag, of Kron magnitudes without a correction
TRACE = 0.3  # px
WAVES = {"GU": (2700.0, 3900.0), "GV": (4300.0, 6000.0), "GI": (6600.0, 9500.0)}  # angstrom, well inside each band


def blocks(text: str) -> list[str]:
    """Return the indented blocks of a README, without their indent."""
    found = re.findall(r"(?:^ {4}.*\n)+", text, flags=re.M)
    return [re.sub(r"^ {4}", "", block, flags=re.M).strip() for block in found]


def follow(folder: Path, work: Path) -> tuple[dict[str, Any], dict[str, Any], float]:
    """Do what a pack's README says; return the scores of MAG_AUTO and of MAG_PSF, and the first one's wall seconds."""
    begin = time.monotonic()
    text = (folder / "public" / "README.md").read_text()
    columns, command, judge = blocks(text)
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    for name in ("public/calibrated", "public/psf", "truth"):
        (work / Path(name).name).symlink_to((folder / name).resolve())

    def result(name: str) -> dict[str, Any]:
        for line in (command, judge):
            line = line.replace("first.", f"{name}.").replace("--output score", f"--output {name}")
            if name == "psf_fit":
                line = line.replace("MAG_AUTO", "MAG_PSF").replace(".param", f".param -PSF_NAME {model}")
            subprocess.run(["bash", "-c", line], cwd=work, check=True)
        return json.loads((work / name / "score.json").read_text())

    (work / "first.param").write_text(columns + "\n")
    (work / "psf_fit.param").write_text(columns + "\nMAG_PSF\n")
    (model,) = re.findall(r"`-PSF_NAME ([^`]+)`", text)
    first, seconds = result("first"), time.monotonic() - begin
    return first, result("psf_fit"), seconds


def traces(folder: Path, catalogue: Path, brightest: int = 12) -> np.ndarray:
    """Return (n,) px: where the first orders of bright sources lie, less where the README's formula puts them."""
    public = folder / "public"
    rows = list(csv.DictReader((public / "frames.csv").open()))
    chips = {row["chip"]: row for row in csv.DictReader((public / "gratings" / "chips.csv").open())}
    table = Table.read(catalogue, format="ascii.sextractor")
    table.sort("MAG_AUTO")
    found = []
    for row in (row for row in rows if row["kind"] == "slitless"):
        with fits.open(public / row["calibrated"]) as file:
            image, header = file["SCI"].data, file["SCI"].header
        x, y = WCS(header).all_world2pix(table["ALPHA_J2000"], table["DELTA_J2000"], 0)
        corner, chip = (header["READX0"] - 1, header["READY0"] - 1), chips[row["chip"]]
        for m, n in list(zip(x + corner[0], y + corner[1], strict=True))[:brightest]:
            grating = chip["left"] if m < float(chip["split"]) else chip["right"]
            at = _trace(
                (public / "gratings" / f"{grating}.conf").read_text(), m, n, np.linspace(*WAVES[row["filter"]], 30)
            )
            found.append(_offset(image, at[0] - corner[0], at[1] - corner[1]))
    return np.array(found)


def _trace(text, m, n, waves):
    """Return x, y on the chip, from 0, of wavelengths in the first order of an object at (m, n)."""
    powers = np.array([1.0, m, n, m * m, m * n, n * n])
    values = {}
    for name in ("XOFF_A", "YOFF_A", "DYDX_A_0", "DYDX_A_1", "DLDP_A_0", "DLDP_A_1"):
        numbers = np.array(re.search(rf"^{name}[ \t]+([^#\n]+)", text, flags=re.M)[1].split(), float)
        values[name] = numbers @ powers[: len(numbers)]
    x0, y0, a0, a1, l0, l1 = values.values()
    x = x0 + (waves - l0) / l1 / np.sqrt(1 + a1 * a1)
    return m + x, n + y0 + a0 + a1 * (x - x0)


def _offset(image, x, y, reach=7):
    """Return by how much light lies above a trace, px: the centroid about the peak; NaN outside of the image."""
    ny, nx = image.shape
    inside = (x > 2) & (x < nx - 3) & (y > reach + 1) & (y < ny - reach - 2)
    if not inside.all():
        return np.nan
    parts = [
        image[round(b) - reach : round(b) + reach + 1, round(a) - 2 : round(a) + 3] for a, b in zip(x, y, strict=True)
    ]
    profile = np.sum([np.median(part, axis=1) for part in parts], axis=0)
    profile = np.clip(profile - np.median(profile), 0, None)
    near = slice(max(profile.argmax() - 2, 0), profile.argmax() + 3)
    return (profile[near] @ np.arange(-reach, reach + 1)[near]) / profile[near].sum() - np.mean(y - np.rint(y))


def main() -> None:
    """Pack, follow the README, and record what came out."""
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        if not shutil.which("source-extractor"):
            record.skip("all", "source-extractor is not installed")
            return
        run = toy_campaign(record) if record.toy else made(ROOT / "config" / "benchmark_pack.yaml")
        folder, before = record.results / "packs" / "pack", cpu_seconds()
        shutil.rmtree(folder, ignore_errors=True)
        pack(run, folder, print)
        record.value("pack_cpu", cpu_seconds() - before, "making the pack", unit="CPU-s")
        total = {row["step"]: row for row in run_times(run)}.get("all", {"CPU [s]": np.nan})
        record.value("campaign_cpu", total["CPU [s]"], "all jobs of the campaign", unit="CPU-s")
        report_size(record, folder)
        report_first(record, *follow(folder, record.results / "packs" / "read"))
        report_traces(record, folder)
        report_merged(record, run, folder, list(dict.fromkeys(job.chip.filter.lower() for job in run.imaging_jobs)))


def toy_campaign(record: Record) -> OpenCampaign:
    """Make a campaign of an image and a frame of spectra on tiny chips."""
    folder = record.results / "packs" / "campaign"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return OpenCampaign(delivery(folder))


def report_size(record: Record, folder: Path) -> None:
    """Record the number of frames, and bytes."""
    frames = list(csv.DictReader((folder / "public" / "frames.csv").open()))
    record.value("frames", len(frames), "frames of the pack")

    def size(name: str) -> int:
        return sum(path.stat().st_size for path in (folder / name).rglob("*") if path.is_file())

    pixels = 0
    for row in frames:
        with fits.open(folder / "public" / row["calibrated"]) as file:
            pixels += file["SCI"].data.size
    record.value("pixels", pixels / len(frames) / 1e6, "pixels of a calibrated frame, mean", unit="million")
    record.value("size", (size("public") + size("truth")) / 1e9, "size of the pack", unit="GB")
    record.value("size_truth", size("truth") / 1e9, "size of its truth", unit="GB")
    record.value("calibrated_bytes", size("public/calibrated") / pixels, "bytes of a calibrated pixel")
    record.value("raw_bytes", size("public/raw") / pixels, "bytes of a raw pixel, over calibrated ones")


def report_first(record: Record, made: dict[str, Any], fitted: dict[str, Any], seconds: float) -> None:
    """Record the scores of source-extractor's catalogues."""
    band, points, galaxies = made["band"], *(made["completeness"][kind] for kind in ("points", "galaxies"))
    auto, psf = made["photometry"][band], fitted["photometry"][band]["points"]
    mean, place = auto["points"]["mean"], made["astrometry_mas"]["points"]
    record.value("seconds", seconds, "from the README to the score, wall time", unit="s")
    what = f"points of S/N above 10 found, of {points['n']}, fraction"
    record.value("points", _number(points["completeness"]), what, above=LEAST)
    record.value("auto_off", abs(_number(mean)), "MAG_AUTO of points less true, absolute mean", unit="mag", below=MOST)
    found = "; ".join(f"{_text(one['completeness'], '.3f')} of {one['n']}" for one in (points, galaxies))
    pure = made["purity"]
    rows = [
        ["completeness of points, of galaxies at S/N above 10", found],
        ["purity; by chance", f"{_text(pure['purity'], '.2f')}; {_text(pure['chance'], '.2f')}"],
        ["MAG_AUTO of points less true [mag]", _pair(auto["points"], "+.3f")],
        ["MAG_AUTO of galaxies less true [mag]", _pair(auto["galaxies"], "+.3f")],
        ["MAG_PSF of points less true, where the fit gives one [mag]", _pair(psf, "+.3f")],
        ["positions of points, east [mas]", _pair(place["east"], "+.1f")],
        ["positions of points, north [mas]", _pair(place["north"], "+.1f")],
    ]
    for axis, one in made.get("shapes", {}).items():
        slope = f"{_text(one['slope'], '.2f')} ± {_text(one['slope_error'], '.2f')}"
        rows.append([f"slope of shapes, {axis} (isophotes, PSF included)", slope])
    record.table("first", [f"source-extractor, one {band} image, by the README alone", ""], rows)


def report_traces(record: Record, folder: Path) -> None:
    """Record where the spectra of the brightest sources lie."""
    away = traces(folder, record.results / "packs" / "read" / "first.cat")
    away = away[np.isfinite(away)]
    middle = float(np.median(away)) if len(away) else np.nan
    record.value("traces", len(away), "first orders of the brightest sources in frames of spectra")
    record.value("traces_within", int((np.abs(away) < 0.25).sum()), "of them within 0.25 px of the README's formula")
    record.value("traces_off", middle, "median of their distance", unit="px", goal=abs(middle) <= TRACE)


def report_merged(record: Record, run: OpenCampaign, folder: Path, bands: list[str]) -> None:
    """Record the score of the campaign's own merged catalogue."""
    maps, main = [f"mag_{band}=total_mag_{band}" for band in bands], "i" if "i" in bands else bands[0]
    dataset = run.paths.output / "merge" / "dataset"
    made = score(dataset, folder / "truth", record.results / "packs" / "merged", print, maps, main)
    every = made["completeness"]["all"]
    record.value("own_objects", every["n"], f"merged catalogue: objects of S/N above 10 in {main}")
    for name in ("completeness", "merged", "lost"):
        record.value(f"own_{name}", every[name], f"merged catalogue: {name} of them, fraction")
    record.value("own_purity", _number(made["purity"]["purity"]), "merged catalogue: purity")
    record.value("own_chance", _number(made["purity"]["chance"]), "of it perhaps by chance")
    for axis, one in made["astrometry_mas"]["points"].items():
        what = f"merged catalogue: points' positions, {axis}"
        record.value(f"own_{axis}", _number(one["mean"]), what, unit="mas", error=_number(one["mean_error"]))
        record.value(f"own_{axis}_scatter", _number(one["scatter"]), f"{what}, scatter", unit="mas")
    rows = [
        [band, *(_pair(made["photometry"][band][kind], "+.3f") for kind in ("points", "galaxies"))]
        for band in bands if band in made["photometry"]
    ]  # fmt: skip
    record.table("own", ["band", "points, total less true [mag]", "galaxies, total less true [mag]"], rows)


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _pair(one: dict[str, Any], form: str) -> str:
    mean, error, scatter = (one[name] for name in ("mean", "mean_error", "scatter"))
    return f"{_text(mean, form)} ± {_text(error, form.lstrip('+'))}, scatter {_text(scatter, form.lstrip('+'))}"


if __name__ == "__main__":
    main()
