"""Fraction of cosmic rays that `measure` finds, and of stars it mistakes for one; astroscrappy's, if installed.

    python benchmarks/cosmic_ray_rejection.py [--filters NUV r y]      # pip install astroscrappy for the second row

`csstsim chip` makes the demo's window in each filter with its truth mask. Rays found: the share of their pixels 5 sigma
or more above the sky and not on defects. Stars: those of S/N above 20, without a ray or a saturated pixel within 3 px,
that have a found pixel within 1 px.
"""

import argparse
import importlib.util
import time
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml
from scipy.ndimage import maximum_filter
from toy_sky import toy_sky

from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.detector.mask import COSMIC_RAY
from csstsim.io.truth import read_truth
from csstsim.measure.calibration.bad_pixels import cosmic_rays
from csstsim.measure.light.photometry import psf_model
from csstsim.stages import chip as chip_stage
from csstsim.stages import psf as psf_stage
from csstsim.stages.calibrate import calibrated_frame

ROOT = Path(__file__).parents[1]
FIELD = 300.092, -59.8671  # of the demo
SNR_MIN = 20
FULL_WELL = 85_000.0  # electrons, for astroscrappy


def campaign(folder: Path, toy: bool) -> OpenCampaign:
    """Write the demo's campaign with a truth mask, or a small window of it; return it opened."""
    folder.mkdir(parents=True, exist_ok=True)
    observation = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())
    observation["layers"][-1]["quantization_and_output"]["mask"] = True
    (folder / "science.yaml").write_text(yaml.safe_dump(observation, sort_keys=False))
    content = load_campaign(ROOT / "config/campaign.yaml").model_dump(mode="json")
    content |= {"output": str(folder), "observations": {"SCIE": str(folder / "science.yaml")}}
    if toy:
        content["window"] = {"x0": 4300, "x1": 4800, "y0": 4300, "y1": 4800}
        content |= toy_sky(folder, *FIELD)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return OpenCampaign(folder / "campaign.yaml")


def finders(calibrated, model):
    """Yield (name, a call that returns the mask of found pixels) for a frame."""
    noise = float(np.mean(list(calibrated.read_noise.values())))
    image, saturated, bad = calibrated.electrons, calibrated.saturated, calibrated.bad
    yield "csstsim", lambda: cosmic_rays(image, saturated, bad, noise, model)
    if importlib.util.find_spec("astroscrappy"):
        import astroscrappy

        how = {"readnoise": noise, "satlevel": FULL_WELL, "sigclip": 4.5, "objlim": 5.0}
        yield "astroscrappy", lambda: astroscrappy.detect_cosmics(image.copy(), inmask=saturated | bad, **how)[0]


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--filters", nargs="+", default=["NUV", "r", "y"])
    with Record(parser) as record:
        if not importlib.util.find_spec("astroscrappy"):
            record.skip("astroscrappy", "not installed")
        compare(record)


def compare(record: Record) -> None:
    """Record what each code finds, by filter."""
    run, rows = campaign(record.results / "cosmic_ray_rejection", record.toy), []
    for band in record.options.filters[: 1 if record.toy else None]:
        job = next(job for job in run.jobs if job.chip.filter == band)
        chip_stage.chip(run, job, log=lambda _: None)
        file, calibrated = calibrated_frame(run, job)
        model = psf_model(psf_stage.open_psf(run, job.chip), (job.window.x0, job.window.y0), job.window.shape)
        rays, sky = file.mask() & COSMIC_RAY > 0, np.median(calibrated.electrons)
        noise = np.sqrt(sky + np.mean(list(calibrated.read_noise.values())) ** 2)
        strong = rays & (calibrated.electrons - sky > 5 * noise) & ~calibrated.bad
        truth = read_truth(run.paths.level0_truth(job))
        near = maximum_filter(rays | calibrated.saturated | calibrated.bad, 7)
        x, y = np.rint(truth["x"] - job.window.x0).astype(int), np.rint(truth["y"] - job.window.y0).astype(int)
        stars = (truth["obj_type"] == 0) & (truth["snr"] > SNR_MIN)
        stars &= (x >= 3) & (x < job.window.nx - 3) & (y >= 3) & (y < job.window.ny - 3)
        x, y = x[stars], y[stars]
        alone = ~near[y, x]
        for name, find in finders(calibrated, model):
            find()
            start = time.process_time()
            found = find()
            cost = 1e9 * (time.process_time() - start) / found.size
            hit = maximum_filter(found, 3)[y, x] & alone
            if name == "csstsim":
                what = f"pixels of cosmic rays above 5 sigma found in {band}, fraction"
                record.value(f"found_{band}", float(found[strong].mean()), what)
                record.value(f"hit_{band}", int(hit.sum()), f"stars of {alone.sum()} in {band} taken for a cosmic ray")
            rows.append([band, name, f"{found[strong].mean():.1%}", f"{hit.sum()} of {alone.sum()}", f"{cost:.0f}"])
    record.table("codes", ["filter", "by", "rays found", "stars taken for one", "ns a pixel"], rows)


if __name__ == "__main__":
    main()
