"""A small campaign run by the commands up to its report, with every product but truth bricks and masters."""

import numpy as np
import yaml
from support.commands import done
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs

CHIPS = (9, 29)  # r, and GV


def finish(file):
    """Run every command of a campaign in this process, up to its report."""
    run = OpenCampaign(file)
    for job in run.jobs:
        verbs = ["chip"]
        verbs += ["measure"] if job in run.imaging_jobs else []
        verbs += ["calibrate"] if job in run.imaging_jobs and run.config.measurement.keep_calibrated else []
        verbs += ["extract"] if job in run.slitless_jobs else []
        for verb in verbs:
            done(verb, file, "--obsid", job.obsid, "--chip", job.chip.id)
    for pix in run.merge_bricks:
        done("merge", file, "--brick", pix)
        done("validate", file, "--brick", pix)
    done("report", file)
    return run


def science(folder, **changes):
    """Write the shipped layer list of science exposures with {layer: parameters} changed; return its file."""
    layers = yaml.safe_load((SHIPPED / "observations" / "science.yaml").read_text())["layers"]
    listed = [{name: param | changes.get(name, {})} for layer in layers for name, param in layer.items()]
    path = folder / "science.yaml"
    path.write_text(yaml.safe_dump({"layers": listed}))
    return path


def delivery(folder):
    """Run 25 stars on an r chip, as many on a grating's, and bias frames of both; return the campaign's file."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(12, 116, 5), np.linspace(12, 116, 5)))
    changes = {
        "observations": {"SCIE": str(science(folder, cosmic_rays={"save_cosmic_image": True}))},
        "measurement": {"keep_calibrated": True, "joint": True},
        "truth": ["parquet", "cat"],
        "select": {"types": ["SCIE", "BIAS"], "chips": list(CHIPS)},
    }
    pointings = POINTINGS[0], POINTINGS[2]
    jobs = [
        job for job in OpenCampaign(write_campaign(folder, pointings, **changes)).jobs if job.pointing.type == "SCIE"
    ]
    ra, dec = np.concatenate([icrs(*job.wcs.pixel_to_world(x, y), job.observer) for job in jobs], axis=1)
    options = {"ra": ra.tolist(), "dec": dec.tolist(), "mag": [20.0] * len(ra)}
    file = write_campaign(
        folder, pointings, catalog={"kind": "support.mini_campaign:Stars", "options": options}, **changes
    )
    finish(file)
    return file
