"""Make docs/figures/demo.png, the picture of the quick start, from the finished demo (make run).

    python benchmarks/demo_picture.py [FOLDER]        of the demo; results/demo if not given

Left: the report's picture of the field in g, r and i. Right: the windowed r-band readout, with the four channels' bias,
gain, prescan and overscan.
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
from csstsim.io.level0 import read_level0
from csstsim.stages.parts.report_pictures import sky_pictures

ROOT = Path(__file__).parents[1]


def main(record: Record) -> None:
    """Draw both pictures; at toy size, of a campaign of tiny chips."""
    if record.toy:
        _, run = made_frames(record.results / "demo_picture")
    else:
        run = OpenCampaign(ROOT / "config" / "campaign.yaml", record.options.folder, copied=True)
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    picture, _ = sky_pictures(run)
    left.imshow(Image.open(io.BytesIO(picture.png)))
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "results" / "demo")
    with Record(parser) as record:
        main(record)
