"""The stray light of the Cycle-9 fields: angles by astropy, levels, gradients in frames, and the depth it costs.

    python benchmarks/stray_light.py            tables, and docs/figures/stray_*.png (two minutes)

Levels are of the boresight, averaged over the exposure; angles are of its start, as in the headers. Exit code 1 if
limb, Moon or Sun differ from astropy's by 0.01 deg, frames from an independent sum by 1%, less than a tenth of the
exposures have earthshine above 10% of zodiacal light, or an exposure over a dark Earth has any.
"""

import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from astropy import units as u
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord, get_body, get_sun
from astropy.time import Time
from scipy.interpolate import RegularGridInterpolator

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import angle
from csstsim.base.units import DAY_S, EARTH_RADIUS_KM
from csstsim.campaign.survey_table import load_survey_table
from csstsim.catalog.selection import reach
from csstsim.instrument.camera import load_camera
from csstsim.instrument.orbit import orbit_after
from csstsim.layers import sky_background
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.state import State
from csstsim.sky import aperture_door, zodiacal
from csstsim.sky.background import COMPONENTS, band_rates, in_band, sky_light
from csstsim.sky.bodies import exposure_angles
from csstsim.sky.directions import helioecliptic, telescope_axes
from csstsim.sky.earthshine import earthshine
from csstsim.sky.parameters import sky_numbers
from csstsim.sky.starlight import star_directions
from csstsim.sky.transmittance import angles

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
FIELDS = ("w1", "w2", "w3", "w4", "w5")
CAMERA = load_camera()
NUMBERS = sky_numbers(CAMERA.sky)
BANDS = {name: filter_ for name, filter_ in CAMERA.filters.items() if name[0] != "G"}
COLOURS = dict(zip(BANDS, plt.cm.turbo(np.linspace(0.05, 0.95, len(BANDS))), strict=True))
POINTS = 200_000  # on the Earth, of the independent sum
MOMENTS = 8  # of an exposure, of the independent sum
# Moments of an exposure for its mean, and their weights: more than the model's three
PARTS, WEIGHTS = 0.5 * np.array(np.polynomial.legendre.leggauss(5)) + np.array([[0.5], [0.0]])


def exposures(field):
    """Return the Pointings of a field's table."""
    return list(load_survey_table(SHIPPED.parent / "survey_tables" / f"{field}_straylight.csv").values())


def astropy_angles(pointings):
    """Return {"limb", "moon", "sun": deg}: astropy's Sun and Moon in the spacecraft's own frame, a spherical Earth."""
    position, velocity = (
        np.array([getattr(p, name) for p in pointings]).T for name in ("sat_position", "sat_velocity")
    )
    times = Time([p.time for p in pointings], scale="utc")
    where, speed = CartesianRepresentation(position * u.km), CartesianRepresentation(velocity * u.km / u.s)
    frame = GCRS(obstime=times, obsgeoloc=where, obsgeovel=speed)
    boresight = SkyCoord([p.ra for p in pointings], [p.dec for p in pointings], unit="deg", frame="icrs")
    boresight = boresight.cartesian.xyz.value
    limb = between(-position, boresight) - np.degrees(np.arcsin(EARTH_RADIUS_KM / np.linalg.norm(position, axis=0)))
    sun, moon = (body.transform_to(frame).cartesian.xyz.value for body in (get_sun(times), get_body("moon", times)))
    return {"limb": limb, "moon": between(moon, boresight), "sun": between(sun, boresight)}


def between(a, b):
    """Return the angles [deg] between vectors (3, n)."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b, axis=0), axis=0), np.sum(a * b, axis=0)))


def dark_below(pointing):
    """Whether all of the Earth that the spacecraft sees is dark from start to end, by astropy's Sun.

    Both ends are enough: along an orbit, the place nearest to the Sun is never on the night side.
    """
    sun = get_sun(Time(pointing.time)).cartesian.xyz.value
    ends = [np.array(moment(pointing, part)[1]) for part in (0.0, 1.0)]
    reach_ = np.degrees([np.arccos(EARTH_RADIUS_KM / np.linalg.norm(place)) for place in ends])
    return bool(np.all(between(sun[:, None], np.array(ends).T) > 90.0 + reach_ + 0.1))


def moment(pointing, part):
    """Return (UTC MJD, position, velocity) of the spacecraft after a part (0 to 1) of an exposure."""
    after = pointing.exptime * part
    return pointing.mjd + after / DAY_S, *orbit_after(pointing.sat_position, pointing.sat_velocity, after)


def survey(field):
    """Return {angle or component: (n,)} of a field; components {band: (n,)} at the boresight, means of exposures."""
    pointings = exposures(field)
    rates = {name: band_rates(f, CAMERA.telescope, CAMERA.detector.pixel_um, NUMBERS) for name, f in BANDS.items()}
    found = {name: {part: [] for part in COMPONENTS} for name in BANDS}
    own = {name: [] for name in ("limb", "moon", "sun", "limb_sun")}
    for p in pointings:
        axes = telescope_axes(p.ra, p.dec, p.pa, CAMERA.telescope.parity)
        beyond = angle(star_directions(NUMBERS), axes[2]) > NUMBERS.transmittance.zenith[0]  # nearer ones are drawn
        lights = [sky_light(axes, axes[2][None], moment(p, part), NUMBERS, beyond) for part in PARTS]
        light = {name: np.tensordot(WEIGHTS, [one[name] for one in lights], 1) for name in lights[0]}
        for name, rate in rates.items():
            for part, value in in_band(light, rate).items():
                found[name][part].append(value[0])
        for name, value in exposure_angles(p.ra, p.dec, p.mjd, p.sat_position, p.sat_velocity).items():
            own[name].append(value)
    levels = {name: {part: np.array(v) for part, v in parts.items()} for name, parts in found.items()}
    own = {name: np.array(v) for name, v in own.items()}
    by_astropy = astropy_angles(pointings)
    off = {name: np.abs(own[name] - value).max() for name, value in by_astropy.items()}
    return levels, own, off, np.array([dark_below(p) for p in pointings])


def levels_of_fields():
    """Print and draw the levels of all fields. Return whether all goals are met, and {field: (levels, angles)}."""
    good, kept = True, {}
    print("field  limb, Moon, Sun: least to most [deg]; off astropy [deg]; earth > 10% zodiacal; no earthshine;")
    print("       over a dark Earth, most earthshine of those; mean of the exposure in r, e-/s/px: least, median, most")
    for field in FIELDS:
        levels, own, off, dark = survey(field)
        r = levels["r"]
        share, most = np.mean(r["earth"] > 0.1 * r["zodiacal"]), r["earth"][dark].max(initial=0.0)
        spans = ", ".join(f"{own[name].min():.0f} to {own[name].max():.0f}" for name in ("limb", "moon", "sun"))
        none = np.mean(r["earth"] == 0.0)
        print(f"{field}     {spans}; {max(off.values()):.4f}; {share:.0%}; {none:.0%}; {dark.mean():.0%}, {most:.2g}")
        for part in ("zodiacal", "earth", "moon", "stars"):
            print(f"       {part:9}", *(f"{value:10.2g}" for value in np.quantile(r[part], [0, 0.5, 1])))
        ratio = r["earth"] / r["zodiacal"]
        print(f"       earth over zodiacal, most: {ratio.max():.1f} at limb {own['limb'][ratio.argmax()]:.1f} deg")
        good &= max(off.values()) < 0.01 and share > 0.1 and most == 0.0
        kept[field] = levels, own
    return good, kept


def draw_levels(kept):
    """Draw components by exposure in r, earthshine by angle, and the share of each band."""
    figure, axes = plt.subplots(2, 2, figsize=(11, 8))
    levels, own = kept["w1"]
    ax = axes[0, 0]
    for part, marker in (("zodiacal", "."), ("earth", "."), ("moon", "x"), ("stars", "+")):
        ax.semilogy(np.maximum(levels["r"][part], 1e-12), marker, ms=4, label=part)
    ax.set(xlabel="exposure of W1", ylabel="r [e-/s/px]", ylim=(1e-8, 3), title="Means of exposures (none: not shown)")
    ax.legend(fontsize=8)
    ax = axes[0, 1]
    every = {name: np.concatenate([a[name] for _, a in kept.values()]) for name in own}
    earth, zodi, moon = (np.concatenate([v["r"][p] for v, _ in kept.values()]) for p in ("earth", "zodiacal", "moon"))
    lit = earth > 0
    dots = ax.scatter(every["limb"][lit], (earth / zodi)[lit], c=every["limb_sun"][lit], s=8, cmap="coolwarm")
    ax.axhline(0.1, color="k", lw=0.8, ls=":")
    ax.set(yscale="log", ylim=(1e-6, 20), xlabel="limb angle [deg]", ylabel="earthshine / zodiacal light, r")
    ax.set_title(f"Five fields; {np.mean(~lit):.0%} of exposures have none")
    figure.colorbar(dots, ax=ax, label="Sun's height at the limb [deg]")
    ax = axes[1, 0]
    ax.scatter(every["moon"], np.maximum(moon / zodi, 1e-12), s=8, color="0.4")
    ax.set(yscale="log", ylim=(1e-9, 1e-2), xlabel="angle to the Moon [deg]", ylabel="moonlight / zodiacal light, r")
    ax.set_title("Five fields (the Moon behind the Earth or the door: none)")
    ax = axes[1, 1]
    for band in BANDS:
        ratio = np.sort(np.concatenate([v[band]["earth"] / v[band]["zodiacal"] for v, _ in kept.values()]))
        ax.semilogx(np.maximum(ratio, 1e-6), 1 - np.arange(len(ratio)) / len(ratio), color=COLOURS[band], label=band)
    ax.axvline(0.1, color="k", lw=0.8, ls=":")
    ax.set(xlim=(1e-4, 10), ylim=(0, 0.7), xlabel="earthshine / zodiacal light", ylabel="share of exposures above it")
    ax.legend(fontsize=8)
    save(figure, "stray_levels")


def independent(pointing, chip, x, y):
    """Return zodiacal light and earthshine [e-/s/px] at pixels x, y of a chip: another interpolation of the
    transmittance (scipy), points spread evenly over the whole Earth, each pixel's own line of sight, eight moments.
    """
    filter_, table = CAMERA.filters[chip.filter], NUMBERS.transmittance
    rates = band_rates(filter_, CAMERA.telescope, CAMERA.detector.pixel_um, NUMBERS)
    turns = np.append(table.azimuth, table.azimuth[0] + 360.0)
    matrix = np.log(np.column_stack([table.matrix, table.matrix[:, 0]]))
    log_pst = RegularGridInterpolator((np.log(table.zenith), turns), matrix)
    wcs = ChipWCS(chip, pointing)
    sky = SkyCoord(*wcs.pixel_to_world(x, y), unit="deg").cartesian.xyz.value.T
    k = np.arange(POINTS) + 0.5
    z, turn = 1 - 2 * k / POINTS, np.pi * (1 + np.sqrt(5)) * k
    ground = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    axes = telescope_axes(pointing.ra, pointing.dec, pointing.pa, CAMERA.telescope.parity)
    zodi, earth = np.zeros((2, len(x)))
    for step in range(MOMENTS):
        mjd, place, _ = moment(pointing, (step + 0.5) / MOMENTS)
        place, time = np.array(place), Time(mjd, format="mjd")
        sun = get_sun(time)
        au, sun = sun.distance.au, sun.cartesian.xyz.value / np.linalg.norm(sun.cartesian.xyz.value)
        longitude, latitude = helioecliptic(sky, sun)
        share = zodiacal.mixture(zodiacal.elongation(longitude, latitude), NUMBERS)
        level = zodiacal.intensity(longitude, latitude, NUMBERS)
        zodi += np.einsum("k,km,m->m", rates["zodiacal"], share, level) / MOMENTS
        ray = ground * EARTH_RADIUS_KM - place
        far = np.linalg.norm(ray, axis=1)
        slant, height = -np.sum(ray * ground, axis=1) / far, ground @ sun
        seen = (slant > 0) & (height > 0)
        area = 4 * np.pi * EARTH_RADIUS_KM**2 / POINTS
        weight = height[seen] / np.pi * slant[seen] * area / far[seen] ** 2 / au**2
        towards = ray[seen] / far[seen, None] @ axes.T
        door_turn = angles(axes @ sun)[1]
        zenith, azimuth = angles(towards)
        open_ = 1.0 - aperture_door.shade(zenith, azimuth, door_turn, NUMBERS.door)
        off_door = aperture_door.scattered(zenith, azimuth, door_turn, NUMBERS.door)
        low, side = np.radians([aperture_door.zenith_angle(NUMBERS.door), door_turn])
        door = np.array([np.sin(low) * np.sin(side), np.sin(low) * np.cos(side), np.cos(low)])
        for i, sight in enumerate(sky @ axes.T):
            direct = np.where(zenith < 90, open_ * pst(log_pst, table, sight, towards), 0.0)
            total = direct @ weight + pst(log_pst, table, sight, door[None])[0] * (off_door @ weight)
            earth[i] += rates["earth"] * total / MOMENTS
    return zodi, earth


def pst(log_pst, table, sight, sources):
    """Return the transmittance from sources (n, 3) to one line of sight."""
    zenith = np.degrees(np.arccos(np.clip(sources @ sight, -1, 1)))
    azimuth = np.degrees(np.arctan2(sources[:, 0] - sight[0], sources[:, 1] - sight[1])) % 360.0
    azimuth = np.where(azimuth < table.azimuth[0], azimuth + 360.0, azimuth)
    inside = np.clip(zenith, table.zenith[0], table.zenith[-1])
    return np.where(zenith > table.zenith[-1], 0.0, np.exp(log_pst((np.log(inside), azimuth))))


def frames(kept):
    """Draw whole chips without noise and compare them with `independent`. Return whether all agree to 1%."""
    good, figure = True, plt.figure(figsize=(11, 3.6))
    at = np.array([0, 4608, 9215]), np.array([0, 4616, 9231])
    x, y = (axis.ravel() for axis in np.meshgrid(*at))
    print("\nframes without noise over an independent sum, at nine places; corner to corner: most over least")
    shown = 0
    for field, chip_id in zip(FIELDS, (9, 22, 8, 7, 11), strict=True):
        levels, own = kept[field]
        ratio = levels["r"]["earth"] / levels["r"]["zodiacal"]
        order = np.argsort(ratio)
        for rank in (len(order) - 1, int(0.8 * len(order)), 0):
            which = order[rank]
            pointing, chip = exposures(field)[which], CAMERA.chips[chip_id]
            exposure = Exposure(pointing, chip, chip.full_window, ChipWCS(chip, pointing), CAMERA)
            state = State.blank(exposure)
            param = sky_background.Param(enable_straylight_model=True)
            state = sky_background.apply(state, param, Streams(1, "1", chip_id, "sky_background"))
            header = state.header
            frame = state.image[y, x] / pointing.exptime
            other = header["sky_rate"] - header["sky_zodiacal"] - header["sky_earth"]
            zodi, earth = independent(pointing, chip, x.astype(float), y.astype(float))
            off = frame / (zodi + earth + other) - 1
            span, expected = frame.max() / frame.min(), (zodi + earth + other).max() / (zodi + earth + other).min()
            print(
                f"{field} chip {chip_id:2} ({chip.filter}) exposure {which:3}: limb {own['limb'][which]:5.1f} deg,"
                f" zodiacal {header['sky_zodiacal']:.4f}, earth {header['sky_earth']:.4f}, others {other:.2g} e-/s/px;"
                f" off by {np.abs(off).max():.2%}; gradient {span:.4f}, expected {expected:.4f}"
            )
            good &= bool(np.abs(off).max() < 0.01) and abs(span / expected - 1) < 0.01
            if rank == len(order) - 1 and shown < 3:
                shown += 1
                ax = figure.add_subplot(1, 3, shown)
                picture = ax.imshow(
                    state.image[::32, ::32] / pointing.exptime, origin="lower", extent=(0, 9216, 0, 9232)
                )
                ax.set_title(f"{field.upper()}, {chip.filter}, limb {own['limb'][which]:.0f} deg", fontsize=10)
                ax.set_xlabel("x [px]")
                figure.colorbar(picture, ax=ax, label="e-/s/px", shrink=0.8)
    save(figure, "stray_gradient")
    return good


def depth(kept):
    """Print and draw the 5-sigma limit of a point source lost to stray light, against the same sky without it."""
    detector, pixels = CAMERA.detector, reach._GAUSSIAN * reach._PSF_HALF_LIGHT**2
    figure, ax = plt.subplots(figsize=(6, 4))
    print("\nmag of a 5-sigma point source lost in 150 s by earthshine and other stray light: median, 90%, most")

    def limit(rate):
        variance = pixels * ((rate + detector.dark) * 150.0 + detector.read_noise**2)
        return -2.5 * np.log10(12.5 + np.sqrt(156.25 + 25 * variance))

    for band in BANDS:
        parts = {p: np.concatenate([v[band][p] for v, _ in kept.values()]) for p in COMPONENTS}
        lost = limit(parts["zodiacal"]) - limit(sum(parts.values()))
        print(f"{band:4}", *(f"{value:6.2f}" for value in np.quantile(lost, [0.5, 0.9, 1.0])))
        ax.semilogx(np.sort(lost + 1e-9), 1 - np.arange(len(lost)) / len(lost), color=COLOURS[band], label=band)
    ax.set(xlim=(1e-3, 1.5), ylim=(0, 0.7), xlabel="lost depth [mag]", ylabel="share of exposures that lose more")
    ax.legend(fontsize=8)
    save(figure, "stray_depth")
    zero = limit(0.2)
    print(
        "r: mag lost against sky 0.2 e-/s/px:",
        *(f"{s:.2f}: {zero - limit(s):.2f}," for s in (0.1, 0.5, 1.0)),
    )


def hst():
    """Print what makes earthshine 1.6 to 2.0 times HST's: the height of the orbit, and where the Sun stands."""
    print("\nearthshine at limb angles 24, 38, 50 deg")
    rows = {"400 km over 540 km (HST), Sun overhead": [], "mean over places of the Sun by day, over Sun overhead": []}
    for limb in (24.0, 38.0, 50.0):
        overhead = noon(limb, 400.0)
        rows["400 km over 540 km (HST), Sun overhead"].append(overhead / noon(limb, 540.0))
        places = [(z, a) for z in np.arange(2.5, 90, 5.0) for a in np.arange(0, 360, 15.0)]
        weights, light = np.array([(np.sin(np.radians(z)), noon(limb, 400.0, z, a)) for z, a in places]).T
        far = ~np.isnan(light)
        rows["mean over places of the Sun by day, over Sun overhead"].append(
            np.average(light[far], weights=weights[far]) / overhead
        )
    for label, values in rows.items():
        print(f"{label}: " + ", ".join(f"{value:.2f}" for value in values))


def noon(limb, altitude, zenith=0.0, azimuth=0.0):
    """Return earthshine for the Sun at zenith angle, azimuth [deg] over the spacecraft; NaN within 50 deg of it."""
    place = np.array([EARTH_RADIUS_KM + altitude, 0.0, 0.0])
    radius = np.degrees(np.arcsin(EARTH_RADIUS_KM / place[0]))
    axes = telescope_axes(-(180.0 - radius - limb), 0.0, 0.0)
    z, a = np.radians([zenith, azimuth])
    sun = np.array([np.cos(z), np.sin(z) * np.cos(a), np.sin(z) * np.sin(a)])
    if axes[2] @ sun > np.cos(np.radians(50.0)):
        return np.nan
    return earthshine(place, sun, axes, np.array([[0.0, 0.0, 1.0]]), angles(axes @ sun)[1], NUMBERS)[0]


def save(figure, name):
    """Write a figure of the docs."""
    figure.tight_layout()
    figure.savefig(FIGURES / f"{name}.png", dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    levels_good, fields = levels_of_fields()
    draw_levels(fields)
    frames_good = frames(fields)
    depth(fields)
    hst()
    print("\nall goals met" if levels_good and frames_good else "\nA GOAL IS MISSED")
    sys.exit(not (levels_good and frames_good))
