"""Make docs/figures/demo.png and show.png, pictures of the quick start and of `csstsim show`, from the finished demo.

    python benchmarks/demo_picture.py [FOLDER]        of the demo; results/demo if not given

Left: the report's picture of the field in g, r and i. Right: the windowed r-band readout, with the four channels' bias,
gain, prescan and overscan. The other picture is that of docs/look.md.
"""

import argparse
import io
from pathlib import Path

from evidence.record import Record

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from toy_campaign import made_frames

from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main as csstsim
from csstsim.io.level0 import read_level0
from csstsim.stages.parts.report_pictures import sky_pictures

ROOT = Path(__file__).parents[1]
SHOWN = ("10100000004", 9), ("5640", "4870", "200")  # frame; inset
SHOW = "--subtract-overscan", "--truth", "--limit", "40", "--limits", "27", "300", "--size", "400"


def main(record: Record) -> None:
    """Draw both pictures; at toy size, of a campaign of tiny chips."""
    if record.toy:
        _, run = made_frames(record.results / "demo_picture")
    else:
        run = OpenCampaign(ROOT / "config" / "campaign.yaml", record.options.folder, copied=True)
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    picture, _ = sky_pictures(run)
    left.imshow(Image.open(io.BytesIO(picture.image)))
    left.set_title("g, r, i: two exposures of 150 s in each")
    left.set_axis_off()
    job = run.first_frames[0]
    part = read_level0(run.paths.level0(job)).frame().astype(float)
    shown = right.imshow(
        part, origin="lower", cmap="gray", vmin=np.percentile(part, 0.5) - 5, vmax=np.percentile(part, 99) + 15,
        interpolation="antialiased",
    )  # fmt: skip
    right.set(title="the r readout: four channels, prescan, overscan", xlabel="column read", ylabel="row read")
    figure.colorbar(shown, ax=right, label="DN", shrink=0.8)
    figure.savefig(record.figure("demo.png"), dpi=80)
    inset = ("40", "40", "20") if record.toy else SHOWN[1]
    job = job if record.toy else run.job(*SHOWN[0])
    words = [run.paths.level0(job), "--output", record.figure("show.png"), "--inset", *inset, *SHOW]
    csstsim(["show", *map(str, words)], standalone_mode=False)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "results" / "demo")
    with Record(parser) as record:
        main(record)
