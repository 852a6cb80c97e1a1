"""Round trip of spectra: objects at nine positions of both gratings of GU, GV and GI chips, rendered and extracted.

    python benchmarks/slitless_round_trip.py [--all] [--chips 3 2 1]

Each position has an isolated star and an isolated galaxy (half-light radius 0.25", disk and bulge), each with a smooth
continuum and one narrow emission line (sigma 2 A). The exposure of 150 s has every layer of science.yaml but charge
transfer and cosmic rays (`--all`: those, too). Prints for each grating: extracted over true light, flux over input, the
line's position against the trace's, its resolving power, lambda over full width at half maximum, and the flux of the
table of lines, which finds it without a redshift, over what was put in.
"""

import argparse
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml

from csstsim.base.units import C_A_S, H_J_S, ab_photon_density
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.spectrum_columns import CUT, DIM, LOST, MASKED
from csstsim.stages import chip as chip_stage
from csstsim.stages import extract as extract_stage

ROOT = Path(__file__).resolve().parents[1]
OBSID = "10100000001"
LINE = {"GU": 3400.0, "GV": 5000.0, "GI": 8000.0}  # angstrom
SIGMA, WIDTH = 2.0, 200.0  # angstrom: of the line, and its equivalent width
MAG = {"star": 16.5, "galaxy": 16.0}
APART = 300.0  # px along y between the star and the galaxy of a position
HALF = 9  # columns on each side of the line
EDGE = 250.0  # px from the edges of a piece, so that no stamp is cut


class Lines(CatalogBase):
    """Objects of constant AB magnitude with one emission line; options ra, dec, kind (lists), line [angstrom]."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        galaxy = {"size_disk": 0.25, "size_bulge": 0.15, "bulge_frac": 0.3, "e1": 0.2, "e2": 0.1}
        rows = zip(self.options["ra"], self.options["dec"], self.options["kind"], strict=True)
        self.objs = [
            MockObject(id=i, type=kind, ra=ra, dec=dec, **(galaxy if kind == "galaxy" else {}))
            for i, (ra, dec, kind) in enumerate(rows)
        ]

    def load_sed(self, obj):
        return {"WAVELENGTH": GRID, "FLUX": spectrum(MAG[obj.type], self.options["line"])}

    def load_norm_filt(self, obj):
        return None


def spectrum(mag, line):
    """Return photon / s / m2 / angstrom on GRID."""
    continuum = ab_photon_density(GRID, mag)
    shape = np.exp(-0.5 * ((GRID - line) / SIGMA) ** 2) / (SIGMA * np.sqrt(2 * np.pi))
    return continuum * (1 + WIDTH * shape)


def places(gratings, chip):
    """Return (n, 2) direct images: nine of each grating whose first order lies on the chip."""
    out = []
    for grating, (x0, x1, *_) in gratings.pieces:
        p, q, *_ = grating.orders[1].lines(chip.detector.nx / 2, chip.detector.ny / 2)
        ends = p + q * np.array(grating.orders[1].range)
        low, high = max(x0, -min(ends.min(), 0), 0.0) + EDGE, min(x1, chip.detector.nx - max(ends.max(), 0)) - EDGE
        out += [
            (x, y + 37.3 * k)
            for k, x in enumerate(np.linspace(low, high, 3) + np.array([0.13, 0.41, 0.77]))
            for y in np.array([400.2, 4600.6, 8500.9])
        ]
    return np.array(out)


def campaign(folder, number, every):
    """Write the campaign of one chip; return it opened."""
    folder.mkdir(parents=True, exist_ok=True)
    layers = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())
    if not every:
        layers["layers"] = [layer for layer in layers["layers"] if not {"CTE_effect", "cosmic_rays"} & set(layer)]
    (folder / "science.yaml").write_text(yaml.safe_dump(layers, sort_keys=False))
    content = {
        "schema_version": 1,
        "name": folder.name, "survey_table": str(ROOT / "survey_tables/demo.csv"), "output": str(folder), "seed": 11,
        "select": {"types": ["SCIE"], "chips": [number], "obsids": [OBSID]}, "psf": {"grid": 10},
        "observations": {"SCIE": str(folder / "science.yaml")},
    }  # fmt: skip
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content))
    run = OpenCampaign(file)
    job = run.job(OBSID, number)
    at = places(run.camera.gratings[number], job.chip)
    x, y = np.repeat(at[:, 0], 2), np.repeat(at[:, 1], 2) + np.tile([0.0, APART], len(at))
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    options = {"ra": ra.tolist(), "dec": dec.tolist(), "kind": ["star", "galaxy"] * len(at)}
    options["line"] = LINE[job.chip.filter]
    file.write_text(yaml.safe_dump(content | {"catalog": {"kind": "slitless_round_trip:Lines", "options": options}}))
    return OpenCampaign(file)


def line_of(part, line):
    """Return (centroid off the trace [px], resolving power) of the line in one extracted spectrum."""
    near = np.argsort(np.abs(part["wavelength"] - line))[: 4 * HALF + 1]
    near = near[np.argsort(part["column"][near])]
    column, light = part["column"][near].astype(float), part["electrons"][near].astype(float)
    step = np.polyfit(part["column"][near], part["wavelength"][near], 1)
    x = column - (line - step[1]) / step[0]
    side = np.abs(x) > HALF
    light = light - np.polyval(np.polyfit(x[side], light[side], 2), x)
    core = np.abs(x) <= HALF
    centroid = (x[core] * light[core]).sum() / light[core].sum()
    # Full width where the profile, linear between columns, has fallen to half of its peak
    peak = int(np.argmax(np.where(core, light, 0)))
    half = light[peak] / 2
    left = next(k for k in range(peak, 0, -1) if light[k - 1] < half)
    right = next(k for k in range(peak, len(light) - 1) if light[k + 1] < half)
    low = x[left] - (light[left] - half) / (light[left] - light[left - 1])
    high = x[right] + (light[right] - half) / (light[right] - light[right + 1])
    return centroid, line / ((high - low) * abs(step[0]))


def found_line(lines, row, kind, line):
    """Return the flux of the line that was found nearest to `line` in an object's spectrum, over what was put in."""
    mine = lines.take(lines["row"] == row)
    given = WIDTH * float(np.interp(line, GRID, ab_photon_density(GRID, MAG[kind]))) * H_J_S * C_A_S / line * 1e3
    off = np.abs(mine["wavelength"] - line)
    return float(mine["flux"][np.argmin(off)]) / given if len(mine) and off.min() < 4 * SIGMA else np.nan


def report(run, job, table):
    """Return a row for each grating and kind of object, and [(kind, light, lines off [px], flux of lines)] of them."""
    out, parts = [], []
    lines = ObjectTable.read(run.paths.lines(*job.key))
    truth, line = ObjectTable.read(run.paths.level0_truth(job)), LINE[job.chip.filter]
    gratings = run.camera.gratings[job.chip.id]
    given = H_J_S * C_A_S / GRID * 1e3
    for grating, (x0, x1, *_) in gratings.pieces:
        for kind in ("star", "galaxy"):
            rows = []
            for row in np.unique(table["row"]):
                x, galaxy = truth["xImage"][row] - 1, truth["obj_type"][row] == 1
                if not x0 <= x < x1 or galaxy != (kind == "galaxy"):
                    continue
                part = table.take((table["row"] == row) & (table["flags"] & (LOST | CUT) == 0))
                shown = part["flags"] & (DIM | MASKED) == 0
                light = part["electrons"][shown].astype(float).sum() / part["model"][shown].astype(float).sum()
                flat = shown & (np.abs(part["wavelength"] - line) > 100)
                input_erg = np.interp(part["wavelength"], GRID, spectrum(MAG[kind], line) * given)
                flux = np.median((part["flux_erg"] / input_erg)[flat])
                rows.append((light, flux, *line_of(part, line), found_line(lines, row, kind, line)))
            light, flux, centroid, power, found = np.array(rows).T
            found = found[np.isfinite(found)]
            parts.append((kind, light, np.abs(centroid), found))
            cells = (
                f"{light.mean():.4f} ({light.min():.4f} to {light.max():.4f})",
                f"{flux.min():.4f} to {flux.max():.4f}",
            )
            line_cells = (
                f"{centroid.mean():+.3f} (largest {np.abs(centroid).max():.3f})",
                f"{power.min():.0f} to {power.max():.0f}",
            )
            line_flux = f"{found.mean():.3f} ({len(found)} found)" if len(found) else "none found"
            out.append([grating.name, kind, len(rows), *cells, *line_cells, line_flux])
    return out, parts


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chips", type=int, nargs="+", default=[3, 2, 1])
    parser.add_argument("--all", action="store_true", help="with charge transfer and cosmic rays")
    with Record(parser) as record:
        trip(record)


def trip(record: Record) -> None:
    """Draw, read out and extract the spectra of each chip; record what came back."""
    options, rows, parts = record.options, [], []
    folder = record.results / ("slitless_round_trip" + ("_all" if options.all else ""))
    for number in options.chips[:1] if record.toy else options.chips:
        run = campaign(folder / f"chip_{number:02d}", number, options.all)
        job = run.job(OBSID, number)
        chip_stage.chip(run, job, log=lambda text: None)
        extract_stage.extract(run, job)
        lines, more = report(run, job, ObjectTable.read(run.paths.spectra(*job.key)))
        rows, parts = rows + lines, parts + more
    for kind, many in (("star", "stars"), ("galaxy", "galaxies")):
        light, off, fluxes = zip(*(part[1:] for part in parts if part[0] == kind), strict=True)
        light = np.concatenate(light)
        error = light.std(ddof=1) / np.sqrt(len(light))
        record.value(f"light_{kind}", light.mean(), f"electrons of {many}, out over in", error=error)
        record.value(f"off_{kind}", max(map(max, off)), f"lines of {many} off their traces, largest", unit="px")
        record.value(f"lines_{kind}", sum(map(len, fluxes)), f"lines of {many} found without a redshift")
        record.value(f"placed_{kind}", len(light), f"{many}")
        if means := [flux.mean() for flux in fluxes if len(flux)]:
            what = f"flux of found lines of {many}, out over in, mean of a grating"
            record.value(f"line_flux_{kind}_minimum", min(means), f"{what}: minimum")
            record.value(f"line_flux_{kind}_maximum", max(means), f"{what}: largest")
    header = ["grating", "object", "number", "electrons out / in", "flux out / in", "line off its trace [px]"]
    record.table("spectra", [*header, "resolving power", "line flux out / in"], rows)


if __name__ == "__main__":
    main()
