"""Total magnitudes of isolated galaxies on skies that the measurement's prior was not made with.

    python benchmarks/light_by_sky.py [--scenes W2 W4 uniform table]     # full chips; five CPU-minutes

W2, W4    r and i chips of two Cycle-9 fields; the prior was compared with the demo's field
uniform   another seed, galaxies without structure
table     a user's table of Sersic galaxies: n log-normal about 1.3, no bulges, sizes and counts unlike the mock's

Each chip is rendered with all layers and measured. The tables have the median of measured less true total magnitude by
the truth's S/N: of all isolated galaxies (galaxy_light.py), and of thirds by size and by the bulge's fraction of the
light, or by n; and the width of the pulls of the fluxes.
"""

import argparse
from pathlib import Path
from typing import Any

from evidence.record import Record

import numpy as np
import yaml
from galaxy_light import compared, spread
from source_extractor import csstsim, emptied
from toy_sky import TOY_PSF

from csstsim.campaign.job import Job
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import GALAXY, ObjectTable

ROOT = Path(__file__).parents[1]
CHIPS = {"r": 9, "i": 7}
SCENES: dict[str, dict[str, Any]] = {
    "W2": {"table": "w2", "obsid": "10102000001", "bands": ("r", "i")},
    "W4": {"table": "w4", "obsid": "10104000001", "bands": ("r", "i")},
    "uniform": {"table": "w2", "obsid": "10102000002", "bands": ("r",), "seed": 2, "structure": "none"},
    "table": {"table": "w2", "obsid": "10102000002", "bands": ("r",)},
}
PULLS, PULLS_ERROR = 0.1, 1.17  # allowed: of their width less 1; of a width from the median deviation, times sqrt(n)
LIMITS = {(8, 20): 0.04, (20, 500): 0.02}  # S/N: mag
PER_SQUARE_ARCMIN = 90  # galaxies of the table
MAGNITUDES, SLOPE = (19.0, 27.5), 0.36  # of the table's counts, dex per mag
THIRDS = "small", "middle", "large"
FEW = 30
TOY_WINDOW = {"x0": 4300, "x1": 5900, "y0": 4300, "y1": 5900}


def sersic_table(file: Path, footprint: tuple[np.ndarray, np.ndarray]) -> None:
    """Write a table of Sersic galaxies on a footprint [deg]."""
    rng = np.random.default_rng(7)
    (west, east), (south, north) = ((edge.min() - 0.01, edge.max() + 0.01) for edge in footprint)
    area = (east - west) * np.cos(np.radians(0.5 * (south + north))) * (north - south) * 3600.0
    count = int(PER_SQUARE_ARCMIN * area)
    low, high = (10.0 ** (SLOPE * (end - MAGNITUDES[1])) for end in MAGNITUDES)
    mag = MAGNITUDES[1] + np.log10(rng.uniform(low, high, count)) / SLOPE
    ratio, angle = rng.uniform(0.25, 1.0, count), rng.uniform(0.0, np.pi, count)
    e = (1.0 - ratio) / (1.0 + ratio)
    columns = {
        "ra": rng.uniform(west, east, count), "dec": rng.uniform(south, north, count), "mag_r": mag,
        "size": np.clip(0.28 * 10.0 ** (-0.1 * (mag - 24.0)) * np.exp(rng.normal(0.0, 0.5, count)), 0.03, 3.0),
        "n": np.clip(1.3 * np.exp(rng.normal(0.0, 0.6, count)), 0.5, 5.5),
        "e1": -e * np.cos(2.0 * angle), "e2": e * np.sin(2.0 * angle),
    }  # fmt: skip
    rows = ["galaxy," + ",".join(f"{value:.7f}" for value in row) for row in zip(*columns.values(), strict=True)]
    file.write_text("\n".join([",".join(["type", *columns]), *rows]) + "\n")


def campaign(folder: Path, name: str, toy: bool) -> Path:
    """Write the campaign of a scene; return its file. toy: of a window, with the table's galaxies."""
    scene = SCENES[name]
    folder.mkdir(parents=True, exist_ok=True)
    emptied(folder)
    content: dict[str, Any] = {
        "schema_version": 1, "name": f"light_{name}", "output": str(folder), "seed": scene.get("seed", 1),
        "survey_table": str(ROOT / f"survey_tables/{scene['table']}.csv"),
        "select": {"obsids": [scene["obsid"]], "chips": [CHIPS[band] for band in scene["bands"][: 1 if toy else None]]},
        "catalog": {"structure": scene.get("structure", "haloes")},
    }  # fmt: skip
    if toy:
        content |= {"window": TOY_WINDOW, "psf": TOY_PSF}
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    if name == "table" or toy:
        (job,) = OpenCampaign(file).jobs
        sersic_table(folder / "objects.csv", job.footprint())
        options = {"file": str(folder / "objects.csv")}
        content["catalog"] = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": options}
        file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def report(record: Record, name: str, run: OpenCampaign, job: Job) -> list[list[object]]:
    """Record the medians of a chip; return the table's rows."""
    truth, found, row, judged = compared(run, job)
    lines: list[list[object]] = []
    for (low, high), limit in LIMITS.items():
        rows = np.flatnonzero((truth["obj_type"] == GALAXY) & judged & (truth["snr"] >= low) & (truth["snr"] < high))
        if len(rows) < FEW and not record.toy:
            raise SystemExit(f"{name} {job.chip.filter}, S/N {low} to {high}: {len(rows)} galaxies, fewer than {FEW}")
        flux, true = found["flux_total"][row[rows]], truth["electrons"][rows]
        off = -2.5 * np.log10(np.maximum(flux / true, 0.01))
        pulls = spread((flux - true) / found["flux_total_err"][row[rows]])
        pulls_error = PULLS_ERROR * pulls / max(len(rows), 1) ** 0.5
        shape = _shape(truth)[rows]
        cells = []
        for kind, values in (("all", None), ("size", truth["size"][rows]), ("shape", shape)):
            for part, some in zip(THIRDS if values is not None else ("",), _thirds(values, len(rows)), strict=True):
                middle = np.median(off[some]) if some.any() else np.nan
                error = 1.25 * spread(off[some]) / some.sum() ** 0.5 if some.any() else np.nan
                what = f"{name}, {job.chip.filter}, S/N {low} to {high}, {kind} {part}: median of total less true"
                key = "_".join(filter(None, (name, job.chip.filter, f"{low}_{high}", kind, part)))
                goal = bool(abs(middle) < limit + 2.0 * error)
                record.value(key, middle, what, unit="mag", error=error, goal=goal)
                cells.append(f"{middle:+.3f} ± {error:.3f}")
        what = f"{name}, {job.chip.filter}, S/N {low} to {high}: width of the pulls of the total flux"
        goal = bool(abs(pulls - 1.0) < PULLS + 2.0 * pulls_error)
        record.value(f"{name}_{job.chip.filter}_{low}_{high}_pulls", pulls, what, error=pulls_error, goal=goal)
        lines.append([name, job.chip.filter, f"{low} - {high}", len(rows), *cells, f"{pulls:.2f} ± {pulls_error:.2f}"])
    return lines


def _shape(truth: ObjectTable) -> np.ndarray:
    """Return the Sersic index of a table's galaxies, or the bulge's fraction of the light."""
    index = np.nan_to_num(truth["n_disk"]) if "n_disk" in truth else np.zeros(len(truth))
    return index if np.ptp(index[truth["obj_type"] == GALAXY]) > 0 else np.nan_to_num(truth["bulge_frac"])


def _thirds(values: np.ndarray | None, count: int) -> list[np.ndarray]:
    """Return the masks (n,) of the smallest, middle and largest third of values; None: one mask of all."""
    if values is None:
        return [np.ones(count, bool)]
    rank = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return [rank * 3 // max(count, 1) == k for k in range(3)]


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    with Record(parser) as record:
        lines = []
        for name in ["table"] if record.toy else record.options.scenes:
            run = OpenCampaign(campaign(record.results / "light_by_sky" / name, name, record.toy))
            for job in run.jobs:
                for command in "chip", "measure":
                    csstsim(command, run, job)
                lines += report(record, name, run, job)
        thirds = [f"{third} third" for third in ("smallest", "middle", "largest")]
        parts = [f"{kind}: {third}" for kind in ("size", "bulge or n") for third in thirds]
        record.table("light", ["sky", "band", "S/N", "galaxies", "all [mag]", *parts, "pulls"], lines)


if __name__ == "__main__":
    main()
