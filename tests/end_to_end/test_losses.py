"""Flat field and shutter, from the option to the file: drawn light, counts in the truth, measurements."""

import numpy as np
import pytest
import yaml
from commands import done
from mini_campaign import write_scene
from readout_state import plain_list

from csstsim.base.rng import Streams
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.io.frames import load_frame
from csstsim.optics.throughput.response import response_map

OBSID, CHIP = "10100000001", 6  # y, towards the corner: both losses are large
X, Y = [40.2, 90.0, 64.5], [50.3, 80.1, 20.0]


def drawn(folder, flat, shutter):
    """Render three stars without sky; return the campaign, the image and the drawn table."""
    folder.mkdir()
    layers = plain_list("science")
    layers[0]["scie_obs"] |= {"flat_fielding": flat, "shutter_effect": shutter}
    layers[1]["sky_background"] |= {"flat_fielding": flat, "shutter_effect": shutter}
    (folder / "science.yaml").write_text(yaml.safe_dump({"layers": layers}))
    path = write_scene(
        folder,
        "Stars",
        X,
        Y,
        17.0,
        chip=CHIP,
        fidelity="noise_free",
        observations={"SCIE": str(folder / "science.yaml")},
    )
    run = OpenCampaign(path)
    for stage in ("psf", "select", "render"):
        obsid = ["--obsid", OBSID] if stage != "psf" else []
        done(stage, path, *obsid, "--chip", CHIP)
    image = load_frame(run.paths.stage(OBSID, CHIP, "render.fits"))[0]["image"]
    return run, image, ObjectTable.read(run.paths.stage(OBSID, CHIP, "drawn.parquet"))


@pytest.mark.parametrize(("flat", "shutter"), [(True, False), (False, True), (True, True)])
def test_objects_and_sky_lose_the_same_light_and_the_truth_counts_what_is_left(tmp_path, flat, shutter):
    _, whole, all_light = drawn(tmp_path / "whole", False, False)
    run, image, left = drawn(tmp_path / "lossy", flat, shutter)
    job = run.job(OBSID, CHIP)
    share = response_map(
        job.chip, job.window, run.camera.filters["y"], 150.0, run.camera.leds, Streams(3, OBSID, CHIP, "x").camera,
        flat=flat, shutter=shutter,
    )  # fmt: skip
    assert np.abs(share - 1).max() > 1e-3
    np.testing.assert_allclose(image, whole * share, rtol=2e-6)
    np.testing.assert_array_equal(left["electrons"], all_light["electrons"])  # nominal stays
    sky = run.camera.filters["y"].sky * 150.0
    light = (image - np.float32(sky) * share).sum(dtype=float)
    assert left["drawn"].sum() == pytest.approx(light, rel=1e-5)
    assert (left["drawn"] < all_light["drawn"] * share.max() * 1.0001).all()
