"""A window of a GV chip with a bright star and a galaxy, for commands about slitless frames at toy size."""

from pathlib import Path

from evidence import ROOT

import numpy as np
import yaml

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs

OBSID, CHIP = "10100000001", 29
WINDOW = {"x0": 1000, "x1": 3900, "y0": 4400, "y1": 4700}
X, Y = (1300.3, 1500.7), (4500.2, 4620.6)
MAGNITUDES = 14.1, 16.5  # of the star, of the galaxy


def toy_campaign(folder: Path) -> Path:
    """Write the campaign of the two objects; return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "schema_version": 1, "name": folder.name, "survey_table": str(ROOT / "survey_tables/demo.csv"),
        "output": str(folder), "seed": 1, "window": WINDOW, "psf": {"grid": 2},
        "select": {"types": ["SCIE"], "obsids": [OBSID], "chips": [CHIP]},
    }  # fmt: skip
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content))
    job = OpenCampaign(file).job(OBSID, CHIP)
    ra, dec = icrs(*job.wcs.pixel_to_world(np.array(X), np.array(Y)), job.observer)
    columns = {
        "type": ["star", "galaxy"], "ra": ra.tolist(), "dec": dec.tolist(), "mag_r": list(MAGNITUDES),
        "size": [0.0, 0.3], "z": [0.0, 0.2],
    }  # fmt: skip
    content["catalog"] = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"columns": columns}}
    file.write_text(yaml.safe_dump(content))
    return file
