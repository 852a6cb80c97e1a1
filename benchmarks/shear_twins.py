"""m and c of shear by the whole chain: four campaigns of one r chip, twins with shapes turned by 90 degrees.

    python benchmarks/shear_twins.py    # after half an hour: examples/shear, each to its report, then csstsim shear

Every galaxy has the same shear, in two campaigns of (0.1, 0.05), in two of the opposite. The mean of the shapes of a
galaxy and of its twin is the shear. m and c are those of sky, camera, `csstsim measure` and its estimator of shapes.
"""

import argparse
import json
from pathlib import Path

from evidence import ROOT
from evidence.record import Record

import yaml
from campaign_gates import made
from paper_bricks import csstsim
from support.mini_campaign import write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.stages.shear import shear

TOY_SIDE = 768  # px of the chip, with galaxies of a 30th of the sky's density
TOY_EXPOSURE = "10100000001,SCIE,60.157,-40.048,-113.4333,2027-11-20T01:08:00,150"  # its chip 9 lies in one brick


def toy_campaign(folder: Path, like: Path) -> Path:
    """Make a campaign of a small chip of few galaxies, with the shear and shapes of another one; return its file."""
    geometry = {"nx": TOY_SIDE, "ny": TOY_SIDE, "channel_nx": TOY_SIDE // 8, "channel_ny": TOY_SIDE // 2}
    content = yaml.safe_load(like.read_text())["catalog"] | {"structure": "none"}
    file = write_campaign(folder / like.stem, [TOY_EXPOSURE], geometry, catalog=content)
    run = OpenCampaign(file)
    (job,) = run.jobs
    for pix in run.sky_bricks:
        if not run.paths.truth(pix).exists():
            csstsim("truth", file, "--brick", pix)
    if not run.paths.measure(*job.key).exists():
        for stage in ("chip", "measure"):
            csstsim(stage, file, "--obsid", job.obsid, "--chip", job.chip.id)
    return file


def main() -> None:
    """Make the campaigns, and record m and c."""
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        files = sorted((ROOT / "examples" / "shear").glob("*.yaml"))
        folder = record.results / "shear_twins"
        folder.mkdir(parents=True, exist_ok=True)
        files = [toy_campaign(folder, file) for file in files] if record.toy else [made(file).file for file in files]
        shear(files, folder / "shear.json", print)
        found, rows = json.loads((folder / "shear.json").read_text()), []
        passed = {gate["name"]: gate["passed"] for gate in found["gates"]}
        for fit in found["fits"]:
            axis, cells = fit["component"], []
            for name in ("m", "c"):
                value, error = fit[name], fit[f"{name}_err"]
                goal = passed[f"shear {name}{axis}"]
                record.value(f"{name}{axis}", value, f"{name} of component {axis}", error=error, goal=goal)
                cells.append(f"{value:+.{2 if name == 'm' else 4}f} ± {error:.{2 if name == 'm' else 4}f}")
            rows.append([axis, *cells])
        record.table("bias", ["component", "m", "c"], rows)
        record.value("galaxies", found["fits"][0]["n"], "galaxies above S/N 10, resolved and isolated, in both twins")


if __name__ == "__main__":
    main()
