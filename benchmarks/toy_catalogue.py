"""A small table of objects in place of the embedded sky, for campaigns at toy size: truth bricks take ten seconds."""

from pathlib import Path
from typing import Any

import numpy as np


def toy_catalogue(folder: Path, ra: float, dec: float, count: int = 200, radius: float = 0.02) -> dict[str, Any]:
    """Write stars and galaxies of 19 to 24 mag within `radius` [deg] of a position; return the campaign's `catalog`."""
    rng = np.random.default_rng(1)
    east, north = rng.uniform(-radius, radius, (2, count))
    columns = {
        "type": np.resize(["star", "galaxy"], count), "ra": ra + east / np.cos(np.radians(dec)), "dec": dec + north,
        "mag_r": rng.uniform(19.0, 24.0, count), "size": np.resize([0.0, 0.3], count),
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "objects.csv"
    rows = [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    file.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(file)}}
