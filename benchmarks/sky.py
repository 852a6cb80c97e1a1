"""The sky model against HST and the nominal sky, and its cost.

    python benchmarks/sky.py            # also docs/figures/sky_bands.png, sky_earthshine.png and sky_moon.png

Everything is for chip centres and the shipped numbers (config/instrument/sky.yaml).
"""

import argparse
import time

from evidence.record import Record

import matplotlib
import numpy as np

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import unit_vectors
from csstsim.base.units import ARCSEC_PER_RAD
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import Pointing
from csstsim.layers import sky_background
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.sky.background import band_rates
from csstsim.optics.sky.background_spectra import V_BAND, magnitude_ratio, photons, solar_continuum, sunlight
from csstsim.optics.sky.bodies import earth_radius
from csstsim.optics.sky.directions import telescope_axes
from csstsim.optics.sky.earthshine import earthshine
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.optics.sky.transmittance import angles, total
from csstsim.optics.sky.zodiacal import REFERENCE, elongation, intensity, mixture, spectrum
from csstsim.simulation.exposure import Exposure, Losses
from csstsim.simulation.state import State

matplotlib.use("agg")
from matplotlib import pyplot as plt

CAMERA = load_camera(SHIPPED / "instrument")
NUMBERS = sky_numbers(CAMERA.sky)
RATES = {name: band_rates(f, CAMERA.telescope, CAMERA.detector.pixel_um, NUMBERS) for name, f in CAMERA.filters.items()}
COLOURS = dict(zip(CAMERA.filters, plt.cm.turbo(np.linspace(0.05, 0.95, len(CAMERA.filters))), strict=True))
PLACE = np.array([6778.137, 0.0, 0.0])  # km, zenith at ra 0, dec 0
HIGH = 2.58e-17  # W m-2 um-1 arcsec-2 at 5500 A: the STIS handbook's "high" earthshine, 2.58e-18 erg s-1 cm-2 A-1
HST_LIMB = np.array([24.0, 38.0, 50.0])
HST_TIMES = np.array([2.0, 1.0, 0.5])  # of "high": STIS handbook, section 6.5
HST_OVER_ZODI = 2.58e-18 / 5.34e-18 * 10 ** (0.4 * (22.7 - 22.1))  # "high" over zodiacal light of V 22.7, at 5500 A
# e-/s/px by the throughput system that filters.yaml names: zodiacal light of V 22.7 and half of HST's high earthshine
PREDICTED = {"NUV": 0.003, "u": 0.021, "g": 0.169, "r": 0.232, "i": 0.228, "z": 0.129, "y": 0.041}
LIMBS = np.array([10.0, 15, 20, 24, 30, 38, 44, 50, 60, 70, 80, 90, 100])


def zodiacal(name, longitude, latitude):
    """e-/s/px."""
    shares = mixture(elongation(longitude, latitude), NUMBERS)
    return np.einsum("k,k...->...", RATES[name]["zodiacal"], shares) * intensity(longitude, latitude, NUMBERS)


def reference_zodi(name):
    """Return e-/s/px of zodiacal light of V = 22.7, with the colour of large elongations, scaled by the Sun's V."""
    colour = 1.0 + NUMBERS.zodiacal.colour[1, 2] * np.log10(V_BAND / REFERENCE)
    over_sun = 10 ** (-0.4 * (22.7 - NUMBERS.bodies.sun_magnitude)) * ARCSEC_PER_RAD**2  # sr-1
    level = over_sun * solar_continuum(REFERENCE, NUMBERS) / colour * 1e8
    return RATES[name]["zodiacal"][1] * level


def earth(name, limb, sun_zenith):
    """Return e-/s/px of earthshine with the Sun `sun_zenith` deg from the zenith, on the side away from the limb."""
    axes = telescope_axes(-(180.0 - np.degrees(earth_radius(PLACE)) - limb), 0.0, 0.0)
    sun = unit_vectors(sun_zenith, 0.0)
    door = angles(axes @ sun)[1]
    return RATES[name]["earth"] * earthshine(PLACE, sun, axes, np.array([[0, 0, 1.0]]), door, NUMBERS)[0]


def moon(name, away, magnitude):
    """Return e-/s/px of a Moon `away` deg off the axis, not shaded by the telescope's door."""
    direction = np.array([[np.sin(np.radians(away)), 0.0, np.cos(np.radians(away))]])
    light = RATES[name]["sun"] * magnitude_ratio(magnitude, NUMBERS)
    return light * total(direction, np.array([[0, 0, 1.0]]), -90.0, NUMBERS)[0, 0]


def reference(record: Record) -> None:
    """Record the bands under zodiacal light of V = 22.7 and half of HST's high earthshine, and the predicted sky."""
    bodies, telescope = NUMBERS.bodies, CAMERA.telescope
    sun = photons(solar_continuum(REFERENCE, NUMBERS), REFERENCE)
    # The model's spectrum at REFERENCE by its own definition, as magnitudes of V by the Sun's
    own = spectrum(np.array([REFERENCE]), NUMBERS)[1, 0] * sun / sunlight(np.array([REFERENCE]), NUMBERS)[0]
    level = bodies.sun_magnitude - 2.5 * np.log10(own / sun)
    pixel = telescope.area_m2 * telescope.pixel_scale**2
    white = pixel * photons(HIGH / 2, REFERENCE) / (1e-10 * sun * NUMBERS.earth.albedo)
    rows, worst = [], 0.0
    for name, predicted in PREDICTED.items():
        sky = RATES[name]["zodiacal"][1] * 10 ** (-0.4 * (22.7 - level)) + white * RATES[name]["earth"]
        departure = "" if name == "NUV" else f"{sky / predicted - 1:+.1%}"
        rows.append([name, f"{sky:.4f}", f"{predicted:.3f}", f"{CAMERA.filters[name].sky:.3f}", departure])
        if name == "NUV":
            record.value(
                "reference_nuv", abs(sky - predicted), "NUV, model less predicted sky", unit="e-/s/px", below=0.001
            )
        else:
            worst = max(worst, abs(sky / predicted - 1))
    record.table("reference", ["band", "model [e-/s/px]", "predicted", "sky of filters.yaml", "departure"], rows)
    record.value("reference_worst", worst, "largest departure of a band from the predicted sky, u to y", below=0.15)


def bands(record: Record) -> None:
    """Record and draw the zodiacal light of each band 90 deg from the Sun in longitude, and the nominal sky."""
    latitude, rows = np.arange(0.0, 90.1, 3.0), []
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8))
    for name, filter_ in CAMERA.filters.items():
        away = zodiacal(name, 90.0, latitude)
        rows.append([name, *(f"{level:.4f}" for level in away[::10]), f"{filter_.sky:.3f}"])
        axes[0].semilogy(latitude, away, color=COLOURS[name], label=name, ls="--" if name[0] == "G" else "-")
        axes[0].plot(91.5, filter_.sky, "<", color=COLOURS[name], ms=5)
    for longitude in (20, 45, 60, 90, 135, 180):
        axes[1].semilogy(
            latitude,
            zodiacal("r", float(longitude), latitude),
            label=f"{longitude}",
            color=plt.cm.plasma(longitude / 220),
        )
    axes[0].set(
        xlabel="ecliptic latitude [deg]",
        ylabel="zodiacal light [e-/s/px]",
        title="90 deg from the Sun; triangles: nominal sky",
    )
    axes[1].set(xlabel="ecliptic latitude [deg]", title="r, by longitude from the Sun [deg]")
    axes[0].legend(ncol=2, fontsize=7)
    axes[1].legend(fontsize=7)
    save(figure, record, "sky_bands")
    header = ["band", *(f"latitude {b:.0f}" for b in latitude[::10]), "nominal"]
    record.table("zodiacal", header, rows)


def limb(record: Record) -> None:
    """Record and draw earthshine over zodiacal light of V 22.7 in r, and that of HST."""
    rows = []
    figure, axis = plt.subplots(figsize=(6, 4))
    for sun_zenith in (0.0, 45.0, 70.0, 85.0, 100.0):
        level = np.array([earth("r", x, sun_zenith) for x in LIMBS]) / reference_zodi("r")
        rows.append([f"{sun_zenith:.0f}", *(f"{each:.2g}" for each in level)])
        if level[0] > 0:
            axis.semilogy(
                LIMBS, level, color=plt.cm.viridis(sun_zenith / 100), label=f"Sun {sun_zenith:.0f} deg from the zenith"
            )
    hst = HST_OVER_ZODI * HST_TIMES
    noon = np.array([earth("r", x, 0.0) for x in HST_LIMB]) / reference_zodi("r")
    record.table("earthshine", ["Sun's zenith angle", *(f"limb {x:.0f}" for x in LIMBS)], rows)
    for angle, ratio in zip(HST_LIMB, noon / hst, strict=True):
        what = f"earthshine at a limb angle of {angle:.0f} deg, Sun overhead, over HST's"
        record.value(f"hst_{angle:.0f}", ratio, what)
    axis.semilogy(HST_LIMB, hst, "ks-", label='HST, bright limb (STIS "high" at 38 deg)')
    axis.fill_between(HST_LIMB, 1.5 * hst, 2 * hst, color="0.8", label="1.5 to 2 times HST")
    axis.set(xlabel="limb angle [deg]", ylabel="earthshine / zodiacal light of V 22.7, r", ylim=(1e-4, 100))
    axis.legend(fontsize=7)
    save(figure, record, "sky_earthshine")


def moonlight(record: Record) -> None:
    """Record and draw moonlight over zodiacal light of V 22.7 in r."""
    away = np.linspace(5, 90, 120)
    figure, axis = plt.subplots(figsize=(6, 4))
    for label, magnitude, limits in (("full Moon", -12.73, {40: 1.0, 60: 0.1}), ("half Moon", -10.0, {})):
        level = np.array([moon("r", x, magnitude) for x in away]) / reference_zodi("r")
        for at, limit in limits.items():
            ratio = moon("r", float(at), magnitude) / reference_zodi("r")
            record.value(f"moon_{at}", ratio, f"{label} {at} deg away over zodiacal light of V 22.7, r", below=limit)
        axis.semilogy(away, level, label=label)
    axis.semilogy([40, 60, 60, 90], [1, 1, 0.1, 0.1], "k:", label="upper bounds expected for CSST")
    axis.axvspan(5, 40, color="0.9", label="within the survey's Moon limit")
    axis.set(xlabel="angle to the Moon [deg]", ylabel="moonlight / zodiacal light of V 22.7, r", xlim=(5, 90))
    axis.legend(fontsize=7)
    save(figure, record, "sky_moon")


def cost(record: Record) -> None:
    """Record the CPU seconds of the layer on a whole chip, best of 3."""
    chip = CAMERA.chips[9]
    pointing = Pointing(
        "SCIE", 60.0, -40.0, -113.4, "2027-06-26T20:35:58", 150.0, (2596.0, 4496.0, -4357.0), (6.0, 3.0, -2.1)
    )
    window = Window(0, 1000, 0, 1000) if record.toy else chip.full_window
    for name, model in (("constant", False), ("model", True)):
        seconds = []
        for _ in range(4):  # the first compiles, or reads the compiled code
            wcs, losses = ChipWCS(chip, pointing), Losses(flat=True, shutter=True)
            state = State.blank(Exposure(pointing, chip, window, wcs, CAMERA, losses=losses))
            state.image += 1.0
            start = time.process_time()
            sky_background.apply(state, sky_background.Param(enable_straylight_model=model), Streams(1, "1", 9, "sky"))
            seconds.append(time.process_time() - start)
        record.value(f"{name}_cpu", min(seconds[1:]), f"a whole chip's sky by the {name}", unit="CPU-s")


def save(figure, record: Record, name: str) -> None:
    """Write a picture of the docs."""
    figure.tight_layout()
    figure.savefig(record.figure(f"{name}.png"), dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        for part in (reference, bands, limb, moonlight, cost):
            part(record)
