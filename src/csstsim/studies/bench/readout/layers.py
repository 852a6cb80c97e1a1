"""Cost of every layer after the objects on a whole chip, compared with other codes (`csstsim bench --readout`).

The frame has 5,000 stars of 1e2 to 1e6 electrons, the sky, and all layers of the shipped science exposure except
scie_obs, with the paper's density of traps. The cost of PRNU is in sky_background, which applies it. Peers (numpy,
scipy, GalSim, astropy) work on one of the 16 channels, or on part of one where it would take minutes; their times are
scaled to a chip. They are used in the usual way: some are less exact (a linear kernel, traps in the mean), none is more
exact.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.rng import Streams, stream
from csstsim.base.shipped import SHIPPED
from csstsim.base.types import FloatArray, PathLike
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.io.level0_writing import write_level0
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.simulation.exposure import Exposure, Losses
from csstsim.simulation.sim_steps import SimSteps
from csstsim.simulation.state import State
from csstsim.studies.bench.readout.arctic import INSTALLED, arctic
from csstsim.studies.bench.readout.cti import speed_accuracy
from csstsim.studies.bench.readout.mcti import ABSENT, Mcti
from csstsim.studies.bench.setting import EXPTIME, POINTING

if TYPE_CHECKING:
    import galsim

    from csstsim.instrument.camera import Camera
    from csstsim.instrument.traps import Traps

CHIP = 9
WRITE = "writing the file"
TOTAL = "readout and file"
PIXELS = 9216 * 9232
SKIES = 40.0, 4.0  # electrons per pixel: a wide band, a narrow one
# number, half the side of a star's stamp [px], its width [px]
STARS = 5000
SPOT = 12
SIGMA = 0.9
_BRIGHT = 1e4  # electrons: fainter stars are rendered as photons, in the plane of counted electrons
_WARM_UP_WINDOW = Window(4096, 5120, 4104, 5128)  # contains the corner of four channels
_CHANNEL = (4616, 1152)
_SENSOR = 96  # px: side of the square that GalSim's sensor fills, photon by photon
_COLUMNS = 32  # number that arcticpy works on


class LayerCosts(NamedTuple):
    """CPU seconds of a chip with a sky [electron / pixel]: {layer: s}, and those of peers {layer: {peer: s}}."""

    sky: float
    seconds: dict[str, float]
    peers: dict[str, dict[str, float]]


class _Peer(NamedTuple):
    """Another code that does a layer's work: a function, and the number of calls for a chip."""

    layer: str
    name: str
    work: Callable[[], object]
    calls: float


def readout(
    folder: Path, log: Callable[[str], object], skies: Sequence[float] = SKIES, mcti: PathLike | None = None
) -> None:
    """Log, for each sky [electron / pixel], the CPU seconds of each layer, of writing the file, and of the peers.

    Then log speed against accuracy of charge transfer (csstsim.studies.bench.readout.cti), with a chart in `folder`.
    mcti: a checkout of MCTI (csstsim.studies.bench.readout.mcti), or None. Raises InputError if it is not one.
    """
    peer = None if mcti is None else Mcti(mcti)
    for costs in layer_costs(folder, skies):
        log(f"\nsky of {costs.sky:g} electrons, {PIXELS / 1e6:.0f} million pixels, one core")
        log("| layer | csstsim, CPU s | ns / pixel | others, CPU s |\n|---|---|---|---|")
        for layer, seconds in costs.seconds.items():
            peers = ", ".join(f"{name} {value:.1f}" for name, value in costs.peers.get(layer, {}).items())
            log(f"| {layer} | {seconds:.2f} | {1e9 * seconds / PIXELS:.1f} | {peers} |")
    if not INSTALLED:
        log("\narcticpy is not installed (csstsim.studies.bench.readout.arctic says how): cte_effect has no peer")
    if mcti is None:
        log(f"\n{ABSENT}")
    speed_accuracy(folder / "cti_speed_accuracy.png", log, mcti=peer)
    log(f"{folder}/cti_speed_accuracy.png")


def layer_costs(folder: Path, skies: Sequence[float] = SKIES, window: Window | None = None) -> Iterator[LayerCosts]:
    """Yield the LayerCosts of each sky [electron / pixel].

    A file is written into `folder`. window: part of the chip that is simulated [default: all].
    """
    camera = load_camera(SHIPPED / "instrument")
    steps = _steps()
    folder.mkdir(parents=True, exist_ok=True)
    first, *_ = skies
    _seconds(_state(camera, first, _WARM_UP_WINDOW), steps, camera, folder)  # compiles before anything is timed
    render_layers = {step.name for step in steps if step.module.STAGE == "render"}
    for sky in skies:
        cpu_s = _seconds(_state(camera, sky, window or camera.chips[CHIP].full_window), steps, camera, folder)
        cpu_s[TOTAL] = sum(seconds for layer, seconds in cpu_s.items() if layer not in render_layers)
        seconds = {name: seconds for name, seconds in cpu_s.items() if name != "prnu_effect"}
        yield LayerCosts(sky, seconds, _peer_costs(sky, camera))


def _steps() -> SimSteps:
    steps = SimSteps(SHIPPED / "observations" / "science.yaml", "SCIE")
    paper = {"cte_effect": {"density_scale": 1.0}}
    steps.steps = [
        replace(step, param=step.param.model_copy(update=paper.get(step.name)))
        for step in steps
        if step.name != "scie_obs"
    ]
    return steps


def _state(camera: Camera, sky: float, window: Window) -> State:
    """Return the State of an exposure with stars rendered and a filter of this `sky` [e-/pixel]."""
    chip = camera.chips[CHIP]
    filters = camera.filters | {chip.filter: replace(camera.filters[chip.filter], sky=sky / EXPTIME)}
    exposure = Exposure(
        POINTING,
        chip,
        window,
        ChipWCS(chip, POINTING),
        replace(camera, filters=filters),
        losses=Losses(flat=True, shutter=True, prnu=True),
    )
    image = np.zeros(window.shape, np.float32)
    counted = np.zeros(window.shape, np.int32)
    rng = stream(1, "bench", "readout")
    axis = np.arange(-SPOT, SPOT + 1)
    spot = np.exp(-0.5 * (axis**2 + axis[:, None] ** 2) / SIGMA**2)
    spot /= spot.sum()
    for electrons in 10 ** rng.uniform(2, 6, STARS * window.nx * window.ny // (chip.detector.nx * chip.detector.ny)):
        x = rng.integers(SPOT, window.nx - SPOT)
        y = rng.integers(SPOT, window.ny - SPOT)
        stamp = slice(y - SPOT, y + SPOT + 1), slice(x - SPOT, x + SPOT + 1)
        if electrons < _BRIGHT:
            counted[stamp] += rng.poisson(electrons * spot)
        else:
            image[stamp] += electrons * spot
    state = State(exposure, image)
    state.counted = counted
    return state


def _seconds(state: State, steps: SimSteps, camera: Camera, folder: Path) -> dict[str, float]:
    """Return {layer: CPU s}."""
    for stage in ("render", "readout", "level0"):
        state = steps.run(state, stage, Streams(1, "bench", CHIP, ""))
        state.forget()
    path = folder / "readout.fits"
    timing = state.header.pop("timing")
    provenance = {"recipe": {}, "seed": 1, "campaign_name": "bench", "layers": steps.describe(), "stages": []}
    start = time.process_time()
    write_level0(path, state, camera.keywords, provenance)
    written = time.process_time() - start
    path.unlink()
    return {name: cpu for name, _, cpu in timing} | {WRITE: written}


def _peer_costs(sky: float, camera: Camera) -> dict[str, dict[str, float]]:
    """Return {layer: {peer: CPU s for a chip}}."""
    rng = stream(1, "bench", "readout peers")
    frame = rng.poisson(sky, _CHANNEL).astype(np.float32)
    costs: dict[str, dict[str, float]] = {}
    for peer in _peers(frame, rng, camera.detector.traps):
        start = time.process_time()
        peer.work()
        costs.setdefault(peer.layer, {})[peer.name] = (time.process_time() - start) * peer.calls
    return costs


def _peers(frame: FloatArray, rng: np.random.Generator, traps: Traps | None) -> Iterator[_Peer]:
    """Yield the peers, which work on a channel or part of one."""
    import galsim
    from astropy.io import fits
    from scipy.ndimage import convolve

    draws = galsim.BaseDeviate(1)
    kernel = rng.normal(0, 1e-6, (5, 5))
    image = galsim.ImageF(frame.copy())
    dn = frame.astype(np.uint16)
    hdu = fits.ImageHDU(dn)
    yield _Peer("poisson_and_dark", "numpy", lambda: rng.poisson(frame + 3.0).astype(np.float32), 16)
    yield _Peer("poisson_and_dark", "GalSim", lambda: image.addNoise(galsim.PoissonNoise(draws)), 16)
    yield _Peer("brighter_fatter", "scipy (linear)", lambda: frame + frame * convolve(frame, kernel), 16)
    yield _Peer("brighter_fatter", "GalSim's SiliconSensor", _sensor(frame, draws), 16 * frame.size / _SENSOR**2)
    yield _Peer("nonlinearity", "numpy", lambda: np.polynomial.polynomial.polyval(frame, (0, 1, -1e-7, -1e-13)), 16)
    yield _Peer("bias", "numpy", lambda: frame + np.float32(500), 16)
    yield _Peer("readout_noise", "numpy", lambda: frame + rng.normal(0, 5, frame.shape), 16)
    yield _Peer("readout_noise", "GalSim", lambda: image.addNoise(galsim.GaussianNoise(draws, 5.0)), 16)
    yield _Peer("gain", "numpy", lambda: frame / np.float32(1.1), 16)
    yield _Peer("quantization_and_output", "numpy", lambda: np.clip(np.rint(frame), 0, 65535).astype(np.uint16), 16)
    yield _Peer(WRITE, "astropy", lambda: hdu.writeto("/dev/null", checksum=True, overwrite=True), 16)
    if INSTALLED:
        assert traps is not None  # of the shipped camera
        columns = frame[:, :_COLUMNS]
        well = (traps.beta, traps.full_well, traps.notch)
        transfer = partial(arctic, columns, traps.density, traps.timescale, well)
        transfer(express=1)  # the first call is slower
        for express in (1, 5):
            yield _Peer(
                "cte_effect", f"arcticpy, express {express}", partial(transfer, express), 16 * frame.shape[1] / _COLUMNS
            )


def _sensor(frame: FloatArray, draws: galsim.BaseDeviate) -> Callable[[], object]:
    """Return a call that collects the electrons of a square with GalSim's sensor, where they repel one another."""
    import galsim

    square = galsim.ImageF(frame[:_SENSOR, :_SENSOR].copy())
    photons = galsim.PhotonArray.makeFromImage(square, rng=draws)
    sensor = galsim.SiliconSensor(rng=draws)
    return lambda: sensor.accumulate(photons, galsim.ImageF(square.bounds))
