"""A camera of one's own: the shipped one, with a band that has the throughput of another."""

import shutil
from pathlib import Path

import yaml

from csstsim.base.shipped import SHIPPED


def instrument_folder(folder: Path, band: str, other: str) -> str:
    """Write the shipped instrument to `folder`/instrument, `band` with the throughput of `other`; return its path."""
    own = shutil.copytree(SHIPPED / "instrument", folder / "instrument")
    filters = yaml.safe_load((own / "filters.yaml").read_text())
    filters[band]["nodes"] = filters[other]["nodes"]
    (own / "filters.yaml").write_text(yaml.safe_dump(filters))
    return str(own)
