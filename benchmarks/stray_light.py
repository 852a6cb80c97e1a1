"""The stray light of the Cycle-9 fields: angles by astropy, levels, gradients in frames, and the depth it costs.

    python benchmarks/stray_light.py            tables, and docs/figures/stray_*.png

Levels are of the boresight, averaged over the exposure; angles are of its start, as in the headers. Goals: limb, Moon
and Sun within 0.01 deg of astropy's, frames within 1% of an independent sum, earthshine above 10% of zodiacal light in
a tenth of the exposures, and none in an exposure over a dark Earth.
"""

import argparse

from evidence.record import Record

import matplotlib
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
from csstsim.optics.sky import aperture_door, zodiacal
from csstsim.optics.sky.background import COMPONENTS, band_rates, in_band, sky_light
from csstsim.optics.sky.bodies import exposure_angles
from csstsim.optics.sky.directions import helioecliptic, telescope_axes
from csstsim.optics.sky.earthshine import earthshine
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.optics.sky.starlight import star_directions
from csstsim.optics.sky.transmittance import angles
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.state import State

matplotlib.use("agg")
from matplotlib import pyplot as plt

FIELDS = ("w1", "w2", "w3", "w4", "w5")
CAMERA = load_camera()
NUMBERS = sky_numbers(CAMERA.sky)
BANDS = {name: filter_ for name, filter_ in CAMERA.filters.items() if name[0] != "G"}
COLOURS = dict(zip(BANDS, plt.cm.turbo(np.linspace(0.05, 0.95, len(BANDS))), strict=True))
TOY_EXPOSURES = 5  # of a field
POINTS, TOY_POINTS = 200_000, 20_000  # on the Earth, of the independent sum
MOMENTS = 8  # of an exposure, of the independent sum
# Moments of an exposure for its mean, and their weights: more than the model's three
PARTS, WEIGHTS = 0.5 * np.array(np.polynomial.legendre.leggauss(5)) + np.array([[0.5], [0.0]])


def exposures(field, toy=False):
    """Return the Pointings of a field's table; with `toy`, some of them."""
    every = list(load_survey_table(SHIPPED.parent / "survey_tables" / f"{field}_straylight.csv").values())
    return every[:: len(every) // TOY_EXPOSURES] if toy else every


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


def survey(pointings):
    """Return {angle or component: (n,)} of exposures; components {band: (n,)} at the boresight, means of exposures."""
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


def levels_of_fields(record: Record) -> dict:
    """Record the angles and levels of all fields; return {field: (levels, angles)}."""
    rows, components, kept, astropy_off, lit, below_dark, changes = [], [], {}, [], [], [], []
    for field in FIELDS:
        levels, own, off, dark = survey(exposures(field, record.toy))
        r = levels["r"]
        lit.append(np.mean(r["earth"] > 0.1 * r["zodiacal"]))
        astropy_off.append(max(off.values()))
        below_dark.append(r["earth"][dark].max(initial=0.0))
        changes.append(r["zodiacal"].max() / r["zodiacal"].min())
        spans = (f"{own[name].min():.0f} to {own[name].max():.0f}" for name in ("limb", "moon", "sun"))
        none = np.mean(r["earth"] == 0.0)
        rows.append([field.upper(), *spans, f"{lit[-1]:.0%} of {dark.size}", f"{none:.0%}", f"{dark.mean():.0%}"])
        for part in ("zodiacal", "earth", "moon", "stars"):
            components.append([field.upper(), part, *(f"{value:.2g}" for value in np.quantile(r[part], [0, 0.5, 1]))])
        kept[field] = levels, own
    header = ["field", "limb [deg]", "Moon [deg]", "Sun [deg]", "earthshine above a tenth of the zodiacal light, r"]
    record.table("fields", [*header, "no earthshine at all", "over a dark Earth"], rows)
    record.table("levels", ["field", "r [e-/s/px]", "minimum", "median", "maximum"], components)
    exposed = sum(levels["r"]["earth"].size for levels, _ in kept.values())
    record.value("exposures", exposed, "exposures of the five fields")
    what = "limb, Moon and Sun of all exposures, compared with astropy's: largest difference"
    record.value("astropy", max(astropy_off), what, unit="deg", below=0.01)
    record.value(
        "lit", min(lit), "exposures with earthshine above a tenth of the zodiacal light, minimum over fields", above=0.1
    )
    record.value("dark", max(below_dark), "largest earthshine in r over a dark Earth", unit="e-/s/px", below=0)
    for word, change in (("minimum", min(changes)), ("maximum", max(changes))):
        record.value(
            f"zodiacal_{word}", change, f"zodiacal light in r over the year, maximum over minimum, {word} over fields"
        )
    r = {part: np.concatenate([levels["r"][part] for levels, _ in kept.values()]) for part in COMPONENTS}
    ratio, limbs = r["earth"] / r["zodiacal"], np.concatenate([own["limb"] for _, own in kept.values()])
    record.value("earth_maximum", ratio.max(), "largest earthshine in r over zodiacal light")
    record.value("earth_most_limb", limbs[ratio.argmax()], "limb angle of that exposure", unit="deg")
    record.value(
        "moon_maximum", (r["moon"] / r["zodiacal"]).max(), "largest moonlight in r over zodiacal light", below=1e-3
    )
    record.value("sun_maximum", r["sun"].max(), "largest sunlight in r", unit="e-/s/px", below=0)
    record.value("stars_median", np.median(r["stars"] / r["zodiacal"]), "starlight in r over zodiacal light, median")
    return kept


def draw_levels(kept: dict, record: Record) -> None:
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
    ax.set(
        xlim=(1e-4, 10), ylim=(0, 0.7), xlabel="earthshine / zodiacal light", ylabel="fraction of exposures above it"
    )
    ax.legend(fontsize=8)
    save(figure, record, "stray_levels")


def independent(pointing, chip, x, y, points=POINTS):
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
    k = np.arange(points) + 0.5
    z, turn = 1 - 2 * k / points, np.pi * (1 + np.sqrt(5)) * k
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
        area = 4 * np.pi * EARTH_RADIUS_KM**2 / points
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


def frames(kept: dict, record: Record) -> None:
    """Record and draw whole chips without noise, compared with `independent`."""
    figure = plt.figure(figsize=(11, 3.6))
    at = np.array([0, 4608, 9215]), np.array([0, 4616, 9231])
    x, y = (axis.ravel() for axis in np.meshgrid(*at))
    rows, worst, slopes, bright, zodiacal_bright, limbs = [], [], [], [], [], []
    shown = 0
    for field, chip_id in list(zip(FIELDS, (9, 22, 8, 7, 11), strict=True))[: 1 if record.toy else None]:
        levels, own = kept[field]
        ratio = levels["r"]["earth"] / levels["r"]["zodiacal"]
        order = np.argsort(ratio)
        for rank in (len(order) - 1, int(0.8 * len(order)), 0):
            which = order[rank]
            pointing, chip = exposures(field, record.toy)[which], CAMERA.chips[chip_id]
            exposure = Exposure(pointing, chip, chip.full_window, ChipWCS(chip, pointing), CAMERA)
            state = State.blank(exposure)
            param = sky_background.Param(enable_straylight_model=True)
            state = sky_background.apply(state, param, Streams(1, "1", chip_id, "sky_background"))
            header = state.header
            frame = state.image[y, x] / pointing.exptime
            other = header["sky_rate"] - header["sky_zodiacal"] - header["sky_earth"]
            points = TOY_POINTS if record.toy else POINTS
            zodi, earth = independent(pointing, chip, x.astype(float), y.astype(float), points)
            off = frame / (zodi + earth + other) - 1
            span, expected = frame.max() / frame.min(), (zodi + earth + other).max() / (zodi + earth + other).min()
            worst.append(np.abs(off).max())
            slopes.append(abs(span / expected - 1))
            sky = (f"{header[f'sky_{part}']:.4f}" for part in ("zodiacal", "earth"))
            frame_of = [f"{field.upper()} {chip_id} ({chip.filter})", f"{own['limb'][which]:.0f}"]
            rows.append([*frame_of, *sky, f"{other:.2g}", f"{worst[-1]:.2%}", f"{span:.4f}", f"{expected:.4f}"])
            if rank == len(order) - 1:
                bright.append(span - 1)
                zodiacal_bright.append(zodi.max() / zodi.min() - 1)
                limbs.append(own["limb"][which])
            if rank == len(order) - 1 and shown < 3:
                shown += 1
                ax = figure.add_subplot(1, 3, shown)
                picture = ax.imshow(
                    state.image[::32, ::32] / pointing.exptime, origin="lower", extent=(0, 9216, 0, 9232)
                )
                ax.set_title(f"{field.upper()}, {chip.filter}, limb {own['limb'][which]:.0f} deg", fontsize=10)
                ax.set_xlabel("x [px]")
                figure.colorbar(picture, ax=ax, label="e-/s/px", shrink=0.8)
    save(figure, record, "stray_gradient")
    header = ["chip", "limb [deg]", "zodiacal [e-/s/px]", "earth", "others", "off by", "gradient", "expected"]
    record.table("frames", header, rows)
    record.value("frame_count", len(rows), "frames without noise, at nine positions each")
    record.value("frames_off", max(worst), "frames less an independent sum, largest of nine positions", below=0.01)
    record.value(
        "gradient_off", max(slopes), "gradient of frames, maximum over minimum, less that of the sum", below=0.01
    )
    record.value("gradient_median", np.median(slopes), "the same, median of frames")
    for name, what, values in (
        ("sum", "all light", bright), ("zodiacal", "zodiacal light alone", zodiacal_bright),
    ):  # fmt: skip
        for word, value in (("minimum", min(values)), ("maximum", max(values))):
            record.value(f"over_chip_{name}_{word}", value, f"change over a chip, brightest exposures: {what}, {word}")
    for word, value in (("minimum", min(limbs)), ("maximum", max(limbs))):
        record.value(f"over_chip_limb_{word}", value, f"limb angles of those exposures, {word}", unit="deg")


def depth(kept: dict, record: Record) -> None:
    """Record and draw the 5-sigma limit of a point source lost to stray light, against the same sky without it."""
    detector, pixels = CAMERA.detector, reach._GAUSSIAN * reach._PSF_HALF_LIGHT**2
    figure, ax = plt.subplots(figsize=(6, 4))
    rows = []

    def limit(rate):
        variance = pixels * ((rate + detector.dark) * 150.0 + detector.read_noise**2)
        return -2.5 * np.log10(12.5 + np.sqrt(156.25 + 25 * variance))

    for band in BANDS:
        parts = {p: np.concatenate([v[band][p] for v, _ in kept.values()]) for p in COMPONENTS}
        lost = limit(parts["zodiacal"]) - limit(sum(parts.values()))
        rows.append([band, *(f"{value:.2f}" for value in np.quantile(lost, [0.5, 0.9, 1.0]))])
        ax.semilogx(np.sort(lost + 1e-9), 1 - np.arange(len(lost)) / len(lost), color=COLOURS[band], label=band)
    ax.set(xlim=(1e-3, 1.5), ylim=(0, 0.7), xlabel="lost depth [mag]", ylabel="fraction of exposures that lose more")
    ax.legend(fontsize=8)
    save(figure, record, "stray_depth")
    header = ["band", "median [mag]", "90% of exposures lose less than [mag]", "maximum [mag]"]
    record.table("depth", header, rows)
    for rate in (0.1, 0.5, 1.0):
        what = f"depth lost in r with a sky of {rate:g} e-/s/px instead of 0.2"
        record.value(f"lost_{rate:g}", limit(0.2) - limit(rate), what, unit="mag")


def hst(record: Record) -> None:
    """Record what makes earthshine higher than HST's: the height of the orbit, and where the Sun stands."""
    lower, by_day = [], {}
    for limb in (24.0, 38.0, 50.0):
        overhead = noon(limb, 400.0)
        lower.append(overhead / noon(limb, 540.0) - 1)
        grid = np.arange(2.5, 90, 30.0 if record.toy else 5.0), np.arange(0, 360, 60.0 if record.toy else 15.0)
        places = [(z, a) for z in grid[0] for a in grid[1]]
        weights, light = np.array([(np.sin(np.radians(z)), noon(limb, 400.0, z, a)) for z, a in places]).T
        far = ~np.isnan(light)
        by_day[f"{limb:.0f}"] = np.average(light[far], weights=weights[far]) / overhead
    for word, value in (("minimum", min(lower)), ("maximum", max(lower))):
        record.value(
            f"lower_orbit_{word}", value, f"earthshine at 400 km over that at 540 km less 1, {word} over angles"
        )
    for limb, share in by_day.items():
        what = f"earthshine at a limb angle of {limb} deg, mean over the Sun by day, over Sun overhead"
        record.value(f"by_day_{limb}", share, what)


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


def save(figure, record: Record, name: str) -> None:
    """Write a picture of the docs."""
    figure.tight_layout()
    figure.savefig(record.figure(f"{name}.png"), dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        fields = levels_of_fields(record)
        draw_levels(fields, record)
        frames(fields, record)
        depth(fields, record)
        hst(record)
