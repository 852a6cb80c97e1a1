"""Frames of a budget: windows of a chip, simulated in memory, as stamps of galaxies and of the PSF.

Frames of one field and Setting differ only in the shear: random numbers of photons are keyed by object, those of noise
and cosmic rays by pixel, those of traps and defects by chip.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.api import Simulation
from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.rng import stream
from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.studies.budget.shear.plan import Setting
from csstsim.studies.budget.shear.sample import EDGE, catalogue_columns, make_galaxies

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.simulation.frame import Frame
    from csstsim.studies.budget.shear.plan import ShearPlan
    from csstsim.studies.budget.shear.sample import Galaxies

# deg: pointing of all fields, away from bright stars; fields differ in noise and galaxies
RA = 60.1172
DEC = -40.0330
BASIC = {
    "scie_obs",
    "sky_background",
    "poisson_and_dark",
    "prescan_overscan",
    "bias",
    "readout_noise",
    "gain",
    "quantization_and_output",
}
# of windows on the chip, in turn, as fractions of the free range
WINDOW_POSITIONS = np.array([(0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)])
# clipping of the sky's level: in units of the noise; minimum of that noise [e-], about two DN
CLIP_SIGMAS = 2.5
NOISE_MIN = 2.0
# of a detection: minimum S/N; maximum distance from the galaxy's position [px]
SNR_MIN = 10.0
MATCH_PX = 4.0


def start_simulation(plan: ShearPlan) -> tuple[Simulation, str]:
    """Return the Simulation that all frames are made from, and the band."""
    simulation = Simulation().replace(seed=plan.seed, psf={"grid": 6})
    first, *_ = plan.chips
    return simulation, simulation._run.camera.chips[first].filter


@dataclass(frozen=True, eq=False)
class Field:
    """One window of galaxies of a sample."""

    simulation: Simulation
    plan: ShearPlan
    band: str
    sample: str
    number: int

    @property
    def chip(self) -> int:
        """The number of its chip."""
        return self.plan.chips[self.number % len(self.plan.chips)]

    @property
    def obsid(self) -> str:
        """Its exposure: the noise differs between fields."""
        return str(10100000001 + self.number)

    @property
    def sign(self) -> float:
        """The sign of the arms' second component, +1 and -1 in turn, so that leakage between components cancels."""
        return 1.0 if self.number // len(self.plan.chips) % 2 == 0 else -1.0

    @property
    def shear(self) -> complex:
        """The complex shear of the arm "plus"."""
        return self.plan.shear * (1 + 1j * self.sign)

    @cached_property
    def aimed(self) -> Simulation:
        """The Simulation of its window."""
        detector = self.simulation._run.camera.detector
        free = np.array([detector.nx, detector.ny]) - self.plan.size
        turn = self.number // len(self.plan.chips)
        x0, y0 = np.rint(WINDOW_POSITIONS[turn % len(WINDOW_POSITIONS)] * free).astype(int).tolist()
        window = x0, x0 + self.plan.size, y0, y0 + self.plan.size
        aimed = self.simulation.aim(RA, DEC, self.chip, size=None, pa=self.plan.pa, obsid=self.obsid)
        return aimed.replace(window=window)

    @cached_property
    def galaxies(self) -> Galaxies:
        """Its Galaxies."""
        window = self.job(False).window
        return make_galaxies(self.plan, self.sample, self.number, window)

    def simulation_of(
        self,
        setting: Setting,
        columns: Mapping[str, AnyArray] | None = None,
        *,
        seed: int | None = None,
        stars: bool = False,
    ) -> Simulation:
        """Return the Simulation of a Setting; seed: of its noise; stars: only the objects, without noise and sky."""
        from astropy.table import Table

        optional = [name for layer in self.aimed.layers for name in layer if name not in BASIC]
        changed = {name.lower(): values for name, values in setting.layers.items()}
        layers = {name: changed.get(name.lower()) for name in optional} | {
            name: values for name, values in setting.layers.items() if name.lower() not in map(str.lower, optional)
        }  # `replace` below raises InputError for an unknown layer
        losses = {"flat_fielding": setting.flat, "shutter_effect": setting.flat}
        layers["scie_obs"] = losses | {"field_dist": setting.distortion}
        layers["sky_background"] = None if stars else losses | {"enable_straylight_model": setting.straylight}
        if not setting.noise:
            layers |= {"poisson_and_dark": None, "readout_noise": None}
        changes = {} if seed is None else {"seed": seed}
        if columns is not None:
            changes["catalog"] = Table(columns)
        noise = setting.noise and not stars
        return self.aimed.replace(layers=layers, fidelity="standard" if noise else "noise_free", **changes)

    def job(self, distortion: bool) -> Job:
        """Return the campaign.job.Job, with or without the field distortion in its map of the sky."""
        if distortion not in self._jobs:
            self._jobs[distortion] = self.simulation_of(Setting(distortion=distortion))._job(self.obsid, self.chip)
        return self._jobs[distortion]

    @cached_property
    def _jobs(self) -> dict[bool, Job]:
        return {}

    def arm(self, setting: Setting, g: complex, seed: int | None = None) -> FloatArray:
        """Return the image (ny, nx) of the galaxies under a shear g, background subtracted [e-]."""
        job = self.job(setting.distortion)
        columns = catalogue_columns(self.galaxies, setting, self.plan, job, self.number, g, self.band)
        return self._image(setting, columns, seed)

    def level(self, noise: bool) -> float:
        """Return the electrons of sky (without losses) and, with noise, of dark current in a pixel."""
        exposure = self.job(False).exposure
        return (exposure.filter.sky + noise * exposure.chip.detector.dark) * exposure.exptime

    def _image(self, setting: Setting, columns: Mapping[str, AnyArray], seed: int | None = None) -> FloatArray:
        simulation = self.simulation_of(setting, columns, seed=seed)
        is_noiseless = not (setting.noise or setting.layers or setting.calibrated)
        frame = (simulation.light if is_noiseless else simulation.chip)(self.obsid, self.chip)
        electrons: FloatArray
        unusable: IntArray
        if is_noiseless:  # not read out: rounded to DN, wings without noise would end at half a DN
            electrons = frame.image
            unusable = np.zeros(frame.image.shape, np.uint8)
        elif setting.calibrated:
            electrons, unusable = _calibrated(simulation, frame, setting.masking)
        else:
            electrons = frame.electrons
            unusable = np.zeros(frame.image.shape, np.uint8)
        if setting.background != "mesh":
            return electrons - np.float32(
                self.level(setting.noise) if setting.background == "known" else level_of(electrons)
            )
        from csstsim.measure.detection.detect import subtract_background

        subtract_background(electrons, unusable)
        return electrons

    def psf(self, setting: Setting) -> FloatArray:
        """Return (n, s, s) stamps of the PSF at the galaxies, as the Setting's analysis assumes it."""
        if setting.psf == "stars":
            return self._fitted_psf(setting)
        stamps = self.true_psf
        if setting.psf == "truth":
            return stamps
        middle = np.argmin(np.hypot(*(v - v.mean() for v in (self.galaxies.x, self.galaxies.y))))
        return np.broadcast_to(stamps[middle], stamps.shape)

    @cached_property
    def true_psf(self) -> FloatArray:
        """(n, s, s) images of single stars at the centre of the galaxies' pixels, each with a sum of 1."""
        from csstsim.optics.psf.psf_file import pixel_response
        from csstsim.stages.psf import open_psf

        columns = self._stars(Setting(), slice(1), self.plan.stars.magnitude)
        simulation = self.simulation_of(Setting(), columns, stars=True)
        truth = simulation.light(self.obsid, self.chip).truth  # makes the PSF set, if there is none
        rates = [truth[f"flux{band}"][0] for band in range(4)]
        fractions = np.array(rates) / sum(rates)
        job = self.job(False)
        half = self.plan.stamp // 2
        psf = open_psf(simulation._run, job.chip)

        def on_pixels(cells: FloatArray) -> FloatArray:
            response = pixel_response(np.tensordot(fractions, cells.astype(float), axes=1), psf.oversampling)
            samples = response.shape[0] // 2 + psf.oversampling * np.arange(-half, half)
            inside = (samples >= 0) & (samples < len(response))  # the stored PSF may end before the stamp
            stamp = np.zeros((2 * half, 2 * half))
            stamp[np.ix_(inside, inside)] = response[np.ix_(samples[inside], samples[inside])]
            return stamp

        mixed = psf.mixed(on_pixels)
        stamps = np.array([mixed(x, y) for x, y in zip(*map(np.rint, (self.galaxies.x, self.galaxies.y)), strict=True)])
        return stamps / stamps.sum(axis=(1, 2), keepdims=True)

    def _fitted_psf(self, setting: Setting) -> FloatArray:
        """Return the stamps of a PSF whose pixels are linear in x and y, fitted to the stars of a separate frame."""
        rows = slice(None, None, self.plan.stars.every)
        stars = self.stamps(self._image(setting, self._stars(setting, rows, self.plan.stars.magnitude)), rows)
        stars /= stars.sum(axis=(1, 2), keepdims=True)
        x = self.galaxies.x
        y = self.galaxies.y
        design = np.stack([np.ones(len(x)), (x - x.mean()) / self.plan.size, (y - y.mean()) / self.plan.size], axis=1)
        fit, *_ = np.linalg.lstsq(design[rows], stars.reshape(len(stars), -1), rcond=None)
        return (design @ fit).reshape(-1, *stars.shape[1:])

    def _stars(self, setting: Setting, rows: slice, magnitude: float) -> dict[str, AnyArray]:
        job = self.job(setting.distortion)
        x = np.rint(self.galaxies.x[rows])
        y = np.rint(self.galaxies.y[rows])
        ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
        ids = np.arange(len(x)) + 1
        return {"id": ids, "ra": ra, "dec": dec, f"mag_{self.band}": np.full(len(x), magnitude)}

    def stamps(self, image: FloatArray, galaxies: slice = slice(None)) -> FloatArray:
        """Return (n, s, s) float64 stamps of an image of the window, [s // 2, s // 2] the pixel of the galaxy."""
        window = self.job(False).window
        half = self.plan.stamp // 2
        x = np.rint(self.galaxies.x[galaxies]).astype(int)
        y = np.rint(self.galaxies.y[galaxies]).astype(int)
        side = np.arange(-half, half)
        pixel_rows = (y - window.y0)[:, None, None] + side[:, None]
        pixel_columns = (x - window.x0)[:, None, None] + side
        return image[pixel_rows, pixel_columns].astype(float)

    def jacobian(self, setting: Setting) -> FloatArray:
        """Return (n, 2, 2) d(x, y) / d(east, north) at the galaxies, as the Setting's analysis assumes it."""
        wcs = self.job(setting.distortion and setting.wcs == "known").wcs
        return wcs.jacobian(*wcs.pixel_to_world(self.galaxies.x, self.galaxies.y))

    def detected(self, image: FloatArray) -> BoolArray:
        """Return bool (n,): galaxies detected in an image by sep with its default kernel, at S/N SNR_MIN or more."""
        import sep
        from scipy.spatial import cKDTree

        sigma = noise_of(image)
        window = self.job(False).window
        sources = sep.extract(np.ascontiguousarray(image), 1.5, err=sigma, minarea=5)
        snr = sources["flux"] / (sigma * np.sqrt(sources["npix"]))
        significant = snr >= SNR_MIN
        positions = np.column_stack([sources["x"][significant] + window.x0, sources["y"][significant] + window.y0])
        if not len(positions):
            return np.zeros(len(self.galaxies), bool)
        distance, _ = cKDTree(positions).query(np.column_stack([self.galaxies.x, self.galaxies.y]))
        return distance < MATCH_PX

    def rng(self, estimator: str) -> np.random.Generator:
        """Return the generator of the noise that an estimator adds, the same in all arms and Settings."""
        return stream(self.plan.seed, "budget", "shear", self.sample, self.number, estimator)


def level_of(image: FloatArray) -> float:
    """Return the sky level [e-]: the mean of pixels near the median, because the median itself is rounded to DN."""
    middle = np.median(image)
    limit = CLIP_SIGMAS * max(noise_of(image), NOISE_MIN)
    return float(np.mean(image[np.abs(image - middle) < limit], dtype=float))


def noise_of(image: FloatArray) -> float:
    """Return the robust sigma of an image's pixels [e-]."""
    sampled = image[EDGE:-EDGE:3, EDGE:-EDGE:3]
    return float(robust_sigma(sampled))


def _calibrated(simulation: Simulation, frame: Frame, masking: bool) -> tuple[FloatArray, IntArray]:
    """Return (electrons, unusable), each (ny, nx), of a frame calibrated with the truth as by `csstsim calibrate`."""
    from csstsim.inject.memory import BaseFrame
    from csstsim.measure.calibration.bad_pixels import fill_bad_pixels
    from csstsim.measure.light.photometry import psf_model
    from csstsim.stages.calibrate import calibrated_of
    from csstsim.stages.psf import open_psf

    assert frame.key is not None  # a Simulation made it
    assert frame.header is not None and frame.readout is not None  # it is read out
    run = simulation._run
    job = simulation._job(*frame.key)
    base = BaseFrame(Path("frame"), frame.header, frame.header, frame.readout, "channels", None, frame.raw)
    calibrated = calibrated_of(run, job, base)
    if not masking:
        return calibrated.electrons, np.zeros(frame.image.shape, np.uint8)
    model = psf_model(open_psf(run, job.chip), (job.window.x0, job.window.y0), job.window.shape)
    unusable = fill_bad_pixels(calibrated, model)
    return calibrated.electrons, unusable
