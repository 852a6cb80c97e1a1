"""Subsets of the optional parts of a science exposure's light, and the conditions that each must meet.

A subset names a chip, a fidelity, a kind of object and its magnitude, and the losses, parts of the PSF and layers that
are left out. Its scene has objects of that kind on a window, drawn by `csstsim.Simulation`. `departures` gives, in
units of their errors:

* account: electrons in the planes minus those that the truth states as drawn; error: ACCOUNT of the light.
* nominal: electrons drawn by the fidelity `noise_free`, minus nominal electrons times losses at each object times the
  share of light on the window, by closed forms; error: NOMINAL. Only where losses and shares are smooth enough.
* mean: light within 6 px of objects, within 40 px, and further off, minus that of `noise_free`; error: Poisson noise of
  the objects and SAME of their light.
* variance: chi^2, about the expectation of `noise_free`, of an image read out by an ideal detector, minus the number of
  pixels; error: that of chi^2 of Poisson numbers. Left out if the truth's `error` states that the method, unlike
  `noise_free`'s, is wrong by more than the noise: so `preview` draws the brightest.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from astropy.table import Table

import csstsim
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.optics.scatter.scattered_light import read_scattered

ACCOUNT = 1e-5, 2e-5  # of the light; wings of spectra are cut off where splines dip below zero
NOMINAL = 1e-3  # of the light
SAME = 5e-4  # of the light, between renderers
SIDE = 600  # px
LONG_SIDE = 1000  # px, of spectra: the zeroth and the first order of what is aimed at
OBSID = "10100000001"
CHIPS = {"r": 9, "NUV": 7, "y": 6, "GV": 29}
FIDELITIES = "standard", "noise_free", "preview", "reference"
KINDS = {"star": {}, "disk": {"size": 0.3, "bulge_frac": 0.0}, "bulge": {"size": 0.2, "bulge_frac": 1.0}}
COUNTS = {13.0: 1, 17.0: 2, 19.0: 4, 20.5: 8, 21.5: 20, 23.0: 40, 24.5: 80, 26.5: 160}  # objects, by magnitude
SPECTRA = 20, 1  # objects at most behind a grating, and by the reference, which takes many seconds for each
OPTIONS = "flat_fielding", "shutter_effect", "field_dist", "wings", "ghosts"
LAYERS = "sky_background", "PRNU_effect"
# A detector without faults
IDEAL = dict.fromkeys(("cosmic_rays", "brighter_fatter", "detector_defects", "blooming", "CTE_effect", "nonlinearity"))
CAMERA = load_camera(SHIPPED / "instrument")
DARK, GAIN = CAMERA.detector.dark * 150.0, 1.1  # electrons of an exposure, electrons a DN
_WELL = 6e4  # electrons: the converter's range


@dataclass(frozen=True)
class Subset:
    """One choice; `out`: the names of OPTIONS and LAYERS that are left out."""

    band: str
    fidelity: str
    kind: str
    mag: float
    out: frozenset = field(default_factory=frozenset)

    @property
    def layers(self):
        """Changes of the layers of science exposures."""
        param = {name: name not in self.out for name in OPTIONS}
        sky = {name: param[name] for name in OPTIONS[:2]}
        changes = IDEAL | {"scie_obs": param, "sky_background": sky}
        return changes | {name: None for name in LAYERS if name in self.out}

    def __str__(self):
        out = " ".join(sorted(self.out)) or "nothing"
        return f"{self.band:3} {self.fidelity:10} {self.kind:5} {self.mag:4} without {out}"


def subsets(count, seed=23):
    """Return so many Subsets, drawn so that each value of each choice comes as often as the others."""
    rng = np.random.default_rng(seed)
    columns = [np.resize(rng.permutation(list(values)), count) for values in (CHIPS, FIDELITIES, KINDS, COUNTS)]
    columns = [rng.permutation(column) for column in columns]
    out = rng.random((count, len(OPTIONS) + len(LAYERS))) < 0.5
    names = np.array(OPTIONS + LAYERS)
    return [
        Subset(str(band), str(fidelity), str(kind), float(mag), frozenset(names[row].tolist()))
        for band, fidelity, kind, mag, row in zip(*columns, out, strict=True)
    ]


def departures(subset, cache):
    """Return {name: departure in units of its error} of a Subset. cache: folder of PSF sets."""
    frames = {}
    for fidelity in {"noise_free", subset.fidelity}:
        sim = _simulation(subset, fidelity, cache)
        frames[fidelity] = sim.light(OBSID, CHIPS[subset.band])
    expected, frame = frames["noise_free"], frames[subset.fidelity]
    ideal = _simulation(subset, subset.fidelity, cache).chip(OBSID, CHIPS[subset.band])
    sky = _sky(subset, cache)
    found = {"account": _account(subset, frame, sky)} | _means(subset, frame, expected, sky)
    other = np.any(np.asarray(frame.truth["method"]) != np.asarray(expected.truth["method"]))
    if not (other and np.any(frame.truth["error"] > 1.0)):
        found["variance"] = _chi2(ideal, expected.image)
    nominal = _nominal(subset, expected, cache)
    return found if nominal is None else found | {"nominal": nominal}


@lru_cache(maxsize=len(CHIPS))
def _aimed(band, cache):
    return csstsim.Simulation(cache=cache).aim(150.1, 2.2, chip=CHIPS[band], size=LONG_SIDE if band == "GV" else SIDE)


def _simulation(subset, fidelity, cache, objects=None):
    catalog = _objects(subset) if objects is None else objects
    return _aimed(subset.band, cache).replace(catalog=catalog, fidelity=fidelity, psf={"grid": 2}, layers=subset.layers)


def _objects(subset):
    rng = np.random.default_rng(int(10 * subset.mag))
    count = COUNTS[subset.mag]
    if subset.band == "GV":
        count = min(count, SPECTRA[subset.fidelity == "reference"])
    x, y = rng.uniform(-200, 200, (2, count))
    degrees = 0.074 / 3600
    columns = {"ra": 150.1 + x * degrees / np.cos(np.radians(2.2)), "dec": 2.2 + y * degrees}
    mag = {f"mag_{band}": np.full(count, subset.mag) for band in ("nuv", "r", "y")}
    kind = "star" if subset.kind == "star" else "galaxy"
    shape = {name: np.full(count, value) for name, value in KINDS[subset.kind].items()}
    return Table({"id": np.arange(1, count + 1)} | columns | mag | {"type": [kind] * count} | shape)


def _sky(subset, cache):
    """Return the sky's light on the window: the same exposure of an object that is not on it."""
    if "sky_background" in subset.out:
        return 0.0
    away = _objects(subset)[:1]
    away["dec"] -= 1.0
    return _simulation(subset, "noise_free", cache, away).light(OBSID, CHIPS[subset.band]).image.astype(float)


def _account(subset, frame, sky):
    light = (frame.image.astype(float) - sky).sum()
    total = frame.image.sum(dtype=float)
    # float32 pixels: the sky's own rounding is a random walk
    rounding = 2.0**-24 * np.sqrt((frame.image.astype(float) ** 2).sum())
    return (light - frame.truth["drawn"].sum()) / (
        ACCOUNT[subset.band == "GV"] * max(light, 1.0) + 6 * rounding + 1e-9 * total
    )


def _zones(subset, frame):
    y, x = np.indices(frame.image.shape)
    if subset.band == "GV":
        return {"mean": np.ones(x.shape, bool)}
    distance = np.full(x.shape, np.inf)
    for u, v in zip(
        frame.truth["xImage"] - 1 - frame.window.x0, frame.truth["yImage"] - 1 - frame.window.y0, strict=True
    ):
        distance = np.minimum(distance, np.hypot(x - u, y - v))
    if subset.fidelity == "preview":  # objects that nobody would see are spread over 64 px
        return {"mean": np.ones(x.shape, bool)}
    return {"mean 6 px": distance < 6, "mean 40 px": (distance >= 6) & (distance < 40), "mean far": distance >= 40}


def _means(subset, frame, expected, sky):
    found, objects = {}, expected.image.astype(float) - sky
    total = objects.sum()
    for name, zone in _zones(subset, expected).items():
        light = objects[zone].sum()
        poisson = light if subset.fidelity in ("standard", "preview") else 0.0
        error = np.sqrt(max(poisson, 0.0) + 1.0 + (SAME * total) ** 2)
        found[name] = (frame.image[zone].sum(dtype=float) - expected.image[zone].sum(dtype=float)) / error
    return found


def _chi2(ideal, light):
    expected = light.astype(float) + DARK
    seen = (expected > 5.0) & (expected < _WELL)
    if seen.sum() < 100:
        return 0.0
    variance = expected[seen] + CAMERA.detector.read_noise**2 + GAIN**2 / 12
    chi2 = ((ideal.electrons.astype(float)[seen] - expected[seen]) ** 2 / variance).sum()
    return (chi2 - seen.sum()) / np.sqrt((2 + expected[seen] / variance**2).sum())


def _nominal(subset, expected, cache):
    """Return the departure of what was drawn from nominal light, times losses, times the share on the window; or None.

    None where there are ghosts, which come on top, or losses that differ from pixel to pixel.
    """
    if subset.band == "GV" or "PRNU_effect" not in subset.out or subset.mag < 14:
        return None
    truth, window = expected.truth, expected.window
    x, y = np.asarray(truth["xImage"] - 1), np.asarray(truth["yImage"] - 1)
    psf = PsfSet(_simulation(subset, "noise_free", cache)._run.paths.psf(CHIPS[subset.band]))
    if "wings" in subset.out:
        node, weight, _ = psf.weights(x, y)
        share = np.einsum("nk,nkb->nb", weight, psf.flux[node]).mean(axis=1)
    else:
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False) + 0.001
        edges = []
        for at, slope, low, high in (
            (x, np.cos(angle), window.x0, window.x1),
            (y, np.sin(angle), window.y0, window.y1),
        ):
            edges.append((np.where(slope > 0, high - 0.5, low - 0.5) - at[:, None]) / slope)
        share = 1 - read_scattered(psf).wing.light_beyond(np.minimum(*edges)).mean(axis=(0, 2))
    lossless = OPTIONS[:2]
    flat = 1.0
    if not set(lossless) <= subset.out:  # the losses, which are smooth, are those that the sky meets
        lit = subset.out - {"sky_background"}
        seen, whole = (_sky(replace(subset, out=out), cache) for out in (lit, lit | set(lossless)))
        flat = (seen / whole)[np.round(y - window.y0).astype(int), np.round(x - window.x0).astype(int)]
    wanted = (truth["electrons"] * flat * share).sum()
    return (truth["drawn"].sum() - wanted) / (NOMINAL * wanted)
