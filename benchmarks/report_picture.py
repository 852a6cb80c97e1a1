"""Make docs/figures/report.png, the focal plane of a report, from the finished release (benchmarks/release.py).

PYTHONPATH=tests:builders python benchmarks/report_picture.py [CAMPAIGN]     needs chromium and chromedriver
"""

import argparse
import tempfile
import time
from pathlib import Path

from matplotlib.image import imread, imsave
from webdriver import browser

from csstsim.campaign.opened import OpenCampaign

TARGET = Path(__file__).parents[1] / "docs" / "figures" / "report.png"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/release.yaml")
    page = OpenCampaign(parser.parse_args().campaign).paths.report
    with tempfile.TemporaryDirectory() as profile, browser(profile) as window:
        window.open(page.resolve().as_uri())
        window.run("document.querySelector('#plane').scrollIntoView()")
        time.sleep(1)  # s, until it is drawn
        right = window.run("return document.querySelector('#plane svg').getBoundingClientRect().right")
        window.screenshot(TARGET)
    imsave(TARGET, imread(TARGET)[:, : round(right) + 16])
    print(TARGET)


if __name__ == "__main__":
    main()
