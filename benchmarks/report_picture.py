"""Make docs/figures/report.png, the focal plane of a report, from the finished release (benchmarks/release.py).

python benchmarks/report_picture.py [CAMPAIGN]     needs chromium and chromedriver
"""

import argparse
import shutil
import sys
import tempfile
import time
from pathlib import Path

from evidence.record import Record

from matplotlib.image import imread, imsave
from support.webdriver import browser

from csstsim.campaign.opened import OpenCampaign


def main() -> None:
    """Take the picture; at toy size, of a page of that form without a campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/release.yaml")
    with Record(parser) as record:
        if not shutil.which("chromium"):
            record.skip("chromium", "not installed")
            return
        page = toy_page(record.results) if record.toy else OpenCampaign(record.options.campaign).paths.report
        if not page.exists():
            sys.exit(f"{page}: missing; made by python benchmarks/release.py")
        picture(page, record.figure("report.png"))


def toy_page(folder: Path) -> Path:
    """Write a page with a focal plane alone; return its path."""
    page = folder / "report_picture" / "index.html"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text("<h2 id=plane>Focal plane</h2><svg width=300 height=200><rect width=300 height=200 /></svg>")
    return page


def picture(page: Path, target: Path) -> None:
    """Take a picture of a page's focal plane."""
    with tempfile.TemporaryDirectory() as profile, browser(profile) as window:
        window.open(page.resolve().as_uri())
        window.run("document.querySelector('#plane').scrollIntoView()")
        time.sleep(1)  # s, until it is drawn
        right = window.run("return document.querySelector('#plane svg, #plane + svg').getBoundingClientRect().right")
        window.screenshot(target)
    imsave(target, imread(target)[:, : round(right) + 16])


if __name__ == "__main__":
    main()
