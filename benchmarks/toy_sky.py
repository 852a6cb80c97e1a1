"""A small table of objects in place of the embedded sky, and a coarse PSF, for campaigns at toy size.

A truth brick takes 10 to 25 s, and the PSF of a chip 17 s.
"""

from pathlib import Path
from typing import Any

import numpy as np

TOY_PSF = {"grid": 2}


def toy_sky(folder: Path, ra: float, dec: float, count: int = 200, radius: float = 0.02) -> dict[str, Any]:
    """Write stars and galaxies of 19 to 24 mag within `radius` [deg] of a position; return the campaign's keys."""
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
    catalog = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(file)}}
    return {"catalog": catalog, "psf": TOY_PSF}
