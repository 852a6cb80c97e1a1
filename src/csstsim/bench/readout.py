"""What every layer after the objects costs on a whole chip, beside others doing the same (`csstsim bench --readout`).

The frame: 5,000 stars of 1e2 to 1e6 electrons, the sky, and all layers of the shipped science exposure but scie_obs.
Peers work on one of the 16 channels (numpy, scipy, GalSim, astropy) or on some columns (arcticpy), times their number.
They do what their users would: some less exactly (a linear kernel for the brighter-fatter effect), none more.
"""

import importlib.util
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from csstsim.bench.setting import EXPTIME, POINTING
from csstsim.config import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.io.level0 import write_level0
from csstsim.optics.wcs import ChipWCS
from csstsim.rng import stream
from csstsim.sim_steps import SimSteps
from csstsim.state import State

CHIP = 9
WRITE = "writing the file"
STARS, SPOT, SIGMA = 5000, 12, 0.9  # number, half the side of a star's stamp [px], its width [px]
_WARM = Window(4096, 5120, 4104, 5128)  # four channels meet in it


def readout(folder, skies, say):
    """Print, for each sky [electron / pixel], the CPU seconds of each layer, of writing the file, and of the peers."""
    camera = load_camera(SHIPPED / "instrument")
    steps = SimSteps(SHIPPED / "observations" / "science.yaml", "SCIE")
    steps.steps = [step for step in steps if step.name != "scie_obs"]
    folder.mkdir(parents=True, exist_ok=True)
    _seconds(_state(camera, skies[0], _WARM), steps, camera, folder)  # compiled before anything is timed
    for sky in skies:
        state = _state(camera, sky, camera.chips[CHIP].full_window)
        pixels, others = state.image.size, _others(sky)
        took = _seconds(state, steps, camera, folder)
        say(f"\nsky of {sky:g} electrons, {pixels / 1e6:.0f} million pixels; CPU seconds")
        say("| layer | csstsim | ns / pixel | others |\n|---|---|---|---|")
        for layer, seconds in (took | {"all": sum(took.values())}).items():
            beside = ", ".join(f"{name} {value:.1f}" for name, value in others.get(layer, {}).items())
            say(f"| {layer} | {seconds:.2f} | {1e9 * seconds / pixels:.1f} | {beside} |")


def _state(camera, sky, window):
    """Return the State of an exposure that has seen stars and meets this sky."""
    chip = camera.chips[CHIP]
    filter_ = replace(camera.filters[chip.filter], sky=sky / EXPTIME)
    image = np.zeros(window.shape, np.float32)
    rng = stream(1, "bench", "readout")
    axis = np.arange(-SPOT, SPOT + 1)
    spot = np.exp(-0.5 * (axis**2 + axis[:, None] ** 2) / SIGMA**2)
    spot /= spot.sum()
    for light in 10 ** rng.uniform(2, 6, STARS * window.nx * window.ny // (chip.detector.nx * chip.detector.ny)):
        x, y = rng.integers(SPOT, window.nx - SPOT), rng.integers(SPOT, window.ny - SPOT)
        image[y - SPOT : y + SPOT + 1, x - SPOT : x + SPOT + 1] += light * spot
    return State(
        chip=chip, filter=filter_, telescope=camera.telescope, pointing=POINTING, catalog=None, window=window,
        wcs=ChipWCS(chip, POINTING), image=image, leds=camera.leds, sky=camera.sky,
    )  # fmt: skip


def _seconds(state, steps, camera, folder):
    """Return {layer: CPU s}."""
    for stage in ("render", "readout", "level0"):
        state = steps.run(state, stage, 1)
    path, start = folder / "readout.fits", time.process_time()
    provenance = {"recipe": {}, "seed": 1, "campaign_name": "bench", "layers": steps.describe(), "stages": []}
    write_level0(path, state, camera.keywords, provenance)
    written = time.process_time() - start
    path.unlink()
    return {name: cpu for name, _, cpu in state.header["timing"]} | {WRITE: written}


def _others(sky):
    """Return {layer: {peer: CPU s for a chip}}."""
    rng = np.random.default_rng(1)
    frame = rng.poisson(sky, (4616, 1152)).astype(np.float32)  # a channel
    found = {}
    for layer, name, work, share in _peers(frame, rng):
        start = time.process_time()
        work()
        found.setdefault(layer, {})[name] = (time.process_time() - start) * share
    return found


def _peers(frame, rng):
    """Yield (layer, peer, a call that does the layer's work, how many of it make a chip)."""
    import galsim
    from astropy.io import fits
    from scipy.ndimage import convolve

    draws, kernel = galsim.BaseDeviate(1), rng.normal(0, 1e-6, (5, 5))
    galsim_image, digits = galsim.ImageF(frame.copy()), frame.astype(np.uint16)
    hdu = fits.ImageHDU(digits)
    yield "poisson_and_dark", "numpy", lambda: rng.poisson(frame + 3.0).astype(np.float32), 16
    yield "poisson_and_dark", "GalSim", lambda: galsim_image.addNoise(galsim.PoissonNoise(draws)), 16
    yield "brighter_fatter", "scipy, linear", lambda: frame + frame * convolve(frame, kernel), 16
    yield "nonlinearity", "numpy", lambda: np.polynomial.polynomial.polyval(frame, (0, 1, -1e-7, -1e-13)), 16
    yield "readout_noise", "numpy", lambda: frame + rng.normal(0, 5, frame.shape), 16
    yield "readout_noise", "GalSim", lambda: galsim_image.addNoise(galsim.GaussianNoise(draws, 5.0)), 16
    yield "quantization_and_output", "numpy", lambda: np.clip(np.rint(frame), 0, 65535).astype(np.uint16), 16
    yield WRITE, "astropy", lambda: hdu.writeto("/dev/null", checksum=True, overwrite=True), 16
    if importlib.util.find_spec("arcticpy"):
        columns = 64
        for express in (1, 5):
            yield "cte_effect", f"arcticpy, express {express}", _arctic(frame[:, :columns], express), 18432 // columns


def _arctic(image, express):
    """Return a call that adds the CTI of cti.yaml's three species with arcticpy, an approximation (mean field)."""
    import arcticpy as arctic

    traps = load_camera(SHIPPED / "instrument").detector.traps
    species = [
        arctic.TrapInstantCapture(density=density, release_timescale=timescale)
        for density, timescale in zip(traps.density, traps.timescale, strict=True)
    ]
    well = arctic.CCD(traps.full_well, well_fill_power=traps.beta, well_notch_depth=traps.notch)
    how = {"parallel_roe": arctic.ROE([1.0]), "parallel_ccd": well, "parallel_traps": species}
    return lambda: arctic.add_cti(image.astype(float), parallel_express=express, **how)
