"""docs/products.md agrees with the code and has every column of the tables that are written."""

import re
import runpy
from pathlib import Path

from commands import done
from csst import BANDS
from mini_campaign import write_scene

from csstsim.catalog.table import ObjectTable

ROOT = Path(__file__).parents[2]


def told(title):
    """Return the names in backticks of one section of the page."""
    text = (ROOT / "docs" / "products.md").read_text()
    return set(re.findall(r"`([^`\n]+)`", re.split(rf"^## {title}$", text, flags=re.M)[1].split("\n## ")[0]))


def test_the_page_has_not_drifted():
    products = runpy.run_path(str(ROOT / "builders" / "make_products.py"))
    assert not products["stale"](), "run python builders/make_products.py"


def test_every_column_of_a_truth_table_is_told(tmp_path):
    campaign = write_scene(tmp_path, "Stars", [30.0, 64.0, 90.0], [40.0, 64.0, 80.0], 20.0)
    done("chip", campaign, "--obsid", "10100000001", "--chip", 9)
    [file] = tmp_path.rglob("*.truth.parquet")
    written = {name for name in ObjectTable.read(file).names if not name.startswith("user_")}
    bands = {f"mag_{band}" for band in BANDS}
    assert bands < written and len(written) > 50 and written - bands | {"mag_B"} <= told("Truth")
