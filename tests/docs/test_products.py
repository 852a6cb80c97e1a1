"""docs/products.md agrees with the code and has every column of the tables that are written."""

import re
import runpy
from pathlib import Path

from support.csst import BANDS

from csstsim.catalog.table import ObjectTable

ROOT = Path(__file__).parents[2]


def told(title):
    """Return the names in backticks of one section of the page."""
    text = (ROOT / "docs" / "products.md").read_text()
    return set(re.findall(r"`([^`\n]+)`", re.split(rf"^## {title}$", text, flags=re.M)[1].split("\n## ")[0]))


def test_the_page_has_not_drifted():
    products = runpy.run_path(str(ROOT / "builders" / "make_products.py"))
    assert not products["stale"](), "run python builders/make_products.py"


def test_every_column_of_a_truth_table_is_told(sound):
    [file] = sound[1].glob("level0/10100000001/*_09_*.truth.parquet")
    written = {name for name in ObjectTable.read(file).names if not name.startswith("user_")}
    bands = {f"mag_{band}" for band in BANDS}
    assert bands < written and len(written) > 50 and written - bands | {"mag_B"} <= told("Truth")
