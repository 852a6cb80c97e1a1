"""The embedded universe's galaxies against published counts, mass functions, sizes, colours and redshifts.

    python benchmarks/galaxy_population.py [--samples FOLDER]

Tables, and docs/figures/galaxies.png. Two samples are used: galaxies placed evenly over mass and redshift,
each representing a number per deg2 (so that rare ones have counts and mass functions, too), and galaxies drawn on 0.04
deg2. With --samples only those in FOLDER are compared: a box of COSMOS2020 (Weaver et al. 2022) and 100 HST galaxies
(GalSim's COSMOS sample).
"""

import argparse
import time
from pathlib import Path

from evidence.record import Record

import matplotlib.pyplot as plt
import numpy as np
from astropy.io import fits
from support import galaxy_sample

from csstsim.base.rng import stream
from csstsim.instrument.load import read_data
from csstsim.universe.galaxies.galaxies import cumulative_counts

Columns = dict[str, np.ndarray]

PUBLISHED = read_data(Path(__file__).resolve().parents[1] / "tests" / "universe" / "published_galaxies.yaml")
AREA, TOY_AREA = 0.04, 0.002  # deg2 drawn
EACH, TOY_EACH = 12, 1  # galaxies of a cell of the even sample
VISTA_Y = (9740, 10660)  # angstrom, half-power points
GROUND = 0.38  # arcsec: flux radius of stars in the COSMOS2020 box, subtracted in quadrature
COLOURS = (("g", "i"), ("r", "i"), ("i", "z"))
BRIGHT = (19, 24.5)  # mag between which counts in i, r and z are evaluated
GROUPS = (  # of published counts: name, survey, mag from and to
    ("GAMA (180 deg²), 18-19.5; u to 20.5", "GAMA", 18, 20.5),
    ("COSMOS (1 deg²), 20-21", "COSMOS", 20, 21),
    ("COSMOS, 21.5-23.5", "COSMOS", 21.5, 23.5),
    ("COSMOS, 24-24.5", "COSMOS", 24, 24.5),
    ("HST (40 arcmin²; g: F435W), 23.25-24", "HST", 23.25, 24),
    ("HST, 24.25-26", "HST", 24.25, 26),
)
HST_BANDS = {"F435W": "g", "F606W": "r", "F775W": "i", "F850LP": "z"}
LINES = {"Hbeta with [OIII]": (4840, 5020), "[OII]": (3700, 3755)}  # angstrom at rest
COSMOS_FILE, HST_FILE = "cosmos2020_box0p25deg2.parquet", "galsim_real_galaxy_catalog_23.5_example_fits.fits"


def even_sample(each: int) -> tuple[Columns, np.ndarray]:
    """Return columns of galaxies, `each` of a cell, and the number per deg2 that each represents."""
    model = galaxy_sample.population()
    cells = np.repeat(np.argwhere(model.grid.density > 0), each, axis=0).T
    columns = model.properties(lambda name: stream(2, name), *model.grid.draw_in_cells(stream(2, "place"), *cells))
    return columns, model.grid.density[tuple(cells)] / each


def select(columns, keep):
    return {name: values[keep] for name, values in columns.items()}


def report_counts(record: Record, ax: plt.Axes, columns: Columns, weight: np.ndarray) -> None:
    mag, total = cumulative_counts(galaxy_sample.numbers())
    columns, weight = select(columns, columns["i"] < 29), weight[columns["i"] < 29]
    m = galaxy_sample.magnitudes(columns)
    centre = np.arange(16.5, 27.1, 1.0)
    edges = np.append(centre - 0.5, centre[-1] + 0.5)
    counts = {band: np.histogram(values, edges, weights=weight)[0] for band, values in m.items()}
    wanted = np.diff(np.interp(edges, mag, total))
    rows = [[f"{c:g}", f"{wanted[k]:,.0f}", *(f"{n[k]:,.0f}" for n in counts.values())] for k, c in enumerate(centre)]
    record.table("counts", ["galaxies per deg² and mag at", "i wanted", *counts], rows)
    record.value("limit", mag[-1], "the faintest i magnitude")
    record.value("density", total[-1] / 3600, "galaxies to this limit", unit="arcmin-2")
    ax.semilogy(mag, np.gradient(total, mag), "k-", lw=0.8, label="i wanted")
    for band, colour in (("nuv", "m"), ("u", "b"), ("g", "c"), ("i", "r"), ("y", "brown")):
        ax.semilogy(centre, counts[band], ".-", color=colour, ms=4, lw=0.7, label=band)
    report_cosmos(record, m, weight)
    report_surveys(record, ax, columns, weight, m["i"])
    real = np.array(PUBLISHED["i_counts"])
    ax.semilogy(real[:, 0], 10 ** real[:, 1], "ro", mfc="none", label="i, Weaver+ 2022")
    u = np.array(PUBLISHED["u_counts"])
    ax.semilogy(u[:, 0], 10 ** u[:, 1], "bs", mfc="none", label="U, Grazian+ 2009")
    ax.set(xlabel="AB mag", ylabel="deg$^{-2}$ mag$^{-1}$", xlim=(16, 29), ylim=(3, 1e6))
    ax.legend(fontsize=6)
    off = [np.log10(weight[np.abs(m["u"] - mag_u) < 0.5].sum()) - log for mag_u, log in PUBLISHED["u_counts"]]
    header = ["U", *(f"{mag_u:.1f}" for mag_u, _ in PUBLISHED["u_counts"])]
    record.table("u_counts", header, [["ours over Grazian et al. [dex]", *(f"{v:+.2f}" for v in off)]])


def report_cosmos(record: Record, m: Columns, weight: np.ndarray) -> None:
    """Record counts in half magnitudes over those of COSMOS2020, and numbers brighter than limits in r."""
    i, cosmos, rows, off = dict(PUBLISHED["i_counts"]), {mag: two for mag, *two in PUBLISHED["cosmos"]}, [], []
    for mag in i:
        known = {"i": i[mag], **dict(zip("rz", cosmos.get(mag, (np.nan, np.nan)), strict=True))}
        with np.errstate(divide="ignore"):
            found = {band: np.log10(weight[np.abs(m[band] - mag) < 0.25].sum() / 0.5) for band in known}
        ratio = [10 ** (found[band] - known[band]) for band in known]
        rows.append([f"{mag:g}", *("" if np.isnan(v) else f"{v:.2f}" for v in ratio)])
        off += [abs(v - 1) for v in ratio if BRIGHT[0] <= mag <= BRIGHT[1]]
    record.table("cosmos", ["mag", "i, ours over COSMOS2020", "r", "z"], rows)
    words = f"largest departure of counts in i, r and z from COSMOS2020 at {BRIGHT[0]:g} to {BRIGHT[1]:g}"
    record.value("cosmos_departure", np.nanmax(off), words, below=0.15)
    limits = PUBLISHED["r_cumulative"]
    rows = [
        ["ours", *(f"{weight[m['r'] < limit].sum():,.0f}" for limit, _ in limits)],
        ["published", *(f"{number:,}" for _, number in limits)],
    ]
    record.table("r_counts", ["galaxies per deg², r <", *(f"{limit:g}" for limit, _ in limits)], rows)


def report_surveys(record: Record, ax: plt.Axes, columns: Columns, weight: np.ndarray, i: np.ndarray) -> None:
    """Record counts over those of other surveys, in their bands; draw HSC's in g and y."""
    hsc, keep = PUBLISHED["hsc_counts"], i < 28
    columns, weight = select(columns, keep), weight[keep]
    level = np.median(i[keep] - galaxy_sample.top_hat(columns, *hsc["bands"]["i"]))  # of the bands' magnitudes
    edges, ratios = np.array(hsc["edges"]), {}
    for band, limits in hsc["bands"].items():
        magnitude = galaxy_sample.top_hat(columns, *limits) + level
        ratios[band] = np.histogram(magnitude, edges, weights=weight)[0] / np.diff(hsc[band])
    others = {}
    for survey, band, limits, entries in PUBLISHED["survey_counts"]:
        magnitude = galaxy_sample.top_hat(columns, *limits) + level
        found = {mag: weight[np.abs(magnitude - mag) < 0.25].sum() / number for mag, number in entries}
        others[survey, HST_BANDS.get(band, band)] = found
    rows = []
    for name, survey, low, high in GROUPS:
        cells = []
        for band in "ugrizy":
            some = [v for mag, v in others.get((survey, band), {}).items() if low <= mag <= high]
            ends = [f"{v:.2f}" for v in (min(some), max(some))] if some else [""]
            cells.append(ends[0] if ends[0] == ends[-1] else "-".join(ends))
        rows.append([name, *cells])
    middle = [[f"HSC, {low:g}-{low + 1:g}", "", *(f"{ratios[band][k]:.2f}" for band in "grizy")]
              for k, low in enumerate(edges[:-1])]  # fmt: skip
    record.table("surveys", ["survey, mag", *"ugrizy"], [rows[0], *middle, *rows[1:]])
    record.value("g_over_hsc", (ratios["g"] / ratios["i"])[3], "counts in g relative to i, over HSC's at 22 to 23")
    for band in "gu":
        i_ratio, own = others["COSMOS", "i"], others["COSMOS", band]
        most = max(own[mag] / i_ratio[mag] for mag in own if 21.5 <= mag <= 23.5)
        what = f"counts in {band} relative to i, over those of COSMOS (Driver et al.) at 21.5 to 23.5, largest"
        record.value(f"{band}_over_cosmos", most, what)
    for band, colour in (("g", "c"), ("y", "brown")):
        ax.semilogy(edges[:-1] + 0.5, np.diff(hsc[band]), "x", color=colour, ms=4, label=f"{band}, HSC")


def weighted_median(values, weight):
    """Return the median of `values` and its error, each value counted `weight` times."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    low, middle, high = np.interp(np.array([0.16, 0.5, 0.84]) * total[-1], total, values[order])
    effective = weight.sum() ** 2 / (weight**2).sum()
    return middle, 1.25 * 0.5 * (high - low) / np.sqrt(effective)


def report_medians(record: Record, ax: plt.Axes, columns: Columns, weight: np.ndarray) -> None:
    """Record median colours and radii by magnitude, beside COSMOS2020 and the Hubble Deep Field; draw r - z."""
    keep = columns["i"] < 27
    columns, weight = select(columns, keep), weight[keep]
    m, half = galaxy_sample.magnitudes(columns, "griz"), galaxy_sample.half_light(columns)

    def near(band: str, mag: float, values: np.ndarray) -> tuple[float, float]:
        here = np.abs(m[band] - mag) < 0.5
        return weighted_median(values[here], weight[here])

    real = PUBLISHED["r_z"]
    r_z = np.subtract(*(galaxy_sample.top_hat(columns, *real[band]) for band in "rz"))  # HSC's bands
    rows, ours = [], []
    for mag, colour in real["medians"]:
        ours.append(near("z", mag, r_z)[0])
        medians = [near("i", mag, m[a] - m[b])[0] for a, b in COLOURS]
        radius = near("i", mag, half)[0]
        rows.append([mag, f"{colour:.2f}", f"{ours[-1]:.2f}", mag, *(f"{v:.2f}" for v in medians), f'{radius:.2f}"'])
        if mag == 21:
            record.value("r_z_21", ours[-1] - colour, "median r - z at z = 21, ours minus COSMOS2020's", unit="mag")
    header = ["z [AB]", "r - z, COSMOS2020", "r - z, ours", "i [AB]", *(f"{a} - {b}" for a, b in COLOURS), "radius"]
    record.table("colours", header, rows)
    mags, theirs = np.transpose(real["medians"])
    ax.plot(mags, ours, "k-", label="csstsim, median")
    ax.plot(mags, theirs, "ro", mfc="none", label="COSMOS2020, median")
    ax.set(xlabel="z", ylabel="r - z, HSC's bands", ylim=(0, 1.5))
    ax.legend(fontsize=6)
    real = PUBLISHED["hubble_deep_field"]
    colour = np.subtract(*(galaxy_sample.top_hat(columns, *real[band]) for band in ("f450w", "f814w")))
    own = [f"{near('i', mag, colour)[0]:.2f}" for mag, _, _ in real["medians"]]
    theirs = [f"{published:.2f} ± {sigma:.2f}" for _, published, sigma in real["medians"]]
    header = ["F450W - F814W at", *(f"{mag:g}" for mag, _, _ in real["medians"])]
    record.table("hubble", header, [["ours", *own], ["Hubble Deep Field (Fernández-Soto et al. 1999)", *theirs]])


def report_lines(record: Record) -> None:
    """Record rest-frame equivalent widths at 1e10 solar masses by redshift, and published ones by rate."""
    published, count = PUBLISHED["line_widths"], 50 if record.toy else 400
    rows = []
    for z in (0.1, 0.5, *published["z"]):
        width, rate = galaxy_sample.line_width(z, published["log_mass"], 6510, 6630, count)
        theirs = f"{published['per_rate'][0] * rate:.0f}" if z in published["z"] else ""
        others = (galaxy_sample.line_width(z, published["log_mass"], *ends, count)[0] for ends in LINES.values())
        rows.append([f"{z:g}", f"{width:.0f}", theirs, *(f"{v:.1f}" for v in others)])
    record.table("lines", ["z", "Halpha with [NII] [Å]", "published, of this rate", *LINES], rows)


def mass_functions(ax: plt.Axes, columns: Columns, weight: np.ndarray) -> None:
    """Draw mass functions of the sample (cells of 0.2 dex), and the published points."""
    cosmology = galaxy_sample.cosmology()
    log_mass = np.log10(columns["bulgemass"] + columns["diskmass"])
    edges = np.arange(8.0, 12.01, 0.2)
    for colour, (z0, z1) in zip("kgrb", ((0.0, 0.1), (0.75, 1.0), (1.0, 1.5), (2.0, 2.5)), strict=True):
        inside = (columns["z"] > z0) & (columns["z"] < z1)
        phi = np.histogram(log_mass[inside], edges, weights=weight[inside])[0] / 0.2 / cosmology.volume(z0, z1)
        ax.semilogy(edges[:-1] + 0.1, phi, "-", color=colour, lw=1, label=f"{z0}-{z1}")
        for entry in PUBLISHED["mass_functions"]:
            if abs(np.mean(entry["z"]) - (z0 + z1) / 2) < 0.13 and entry["z"][0] in (z0, 0.0):
                points = np.array(entry["points"])
                error = 10 ** points[:, 1] * np.log(10) * points[:, 2]
                ax.errorbar(points[:, 0], 10 ** points[:, 1], error, fmt="o", ms=3, lw=0.7, color=colour)
    ax.set(xlabel="log M [solar]", ylabel="Mpc$^{-3}$ dex$^{-1}$", xlim=(8, 12), ylim=(1e-6, 0.1))
    ax.text(8.1, 2e-6, "points: Baldry+ 2012, Tomczak+ 2014,\nMuzzin+ 2013", fontsize=6)
    ax.legend(fontsize=6, title="z", title_fontsize=6)


def report_sizes(record: Record, ax: plt.Axes, columns: Columns) -> None:
    half = galaxy_sample.half_light(columns)
    e = np.hypot(columns["e1"], columns["e2"])
    axis = half * np.sqrt((1 + e) / (1 - e))
    centre = np.arange(19, 30)
    near = [np.abs(columns["i"] - m) < 0.5 for m in centre]
    some = [np.percentile(half[here], [16, 50, 84]) if here.any() else np.full(3, np.nan) for here in near]
    long = [np.median(axis[here]) if here.any() else np.nan for here in near]
    miller = 1.678347 * np.exp(-1.145 - 0.269 * (centre - 23))
    rows = [[m, *(f"{v:.3f}" for v in (*three, a, known))]
            for m, three, a, known in zip(centre, some, long, miller, strict=True)]  # fmt: skip
    header = ["i", "16% of radii [arcsec]", "50%", "84%", "median semi-major axis", "Miller et al. 2013"]
    record.table("sizes", header, rows)
    low, middle, high = np.transpose(some)
    ax.fill_between(centre, low, high, color="0.8")
    ax.semilogy(centre, middle, "k-", label="csstsim: median, 68%")
    ax.semilogy(centre, long, "k:", label="semi-major axis")
    ax.semilogy(centre, miller, "r--", label="axis, Miller+ 2013")
    ax.set(xlabel="i", ylabel="half-light radius [arcsec]", xlim=(18, 30))
    ax.legend(fontsize=6)


def report_redshifts(record: Record, ax: plt.Axes, columns: Columns) -> None:
    bins, rows = np.arange(0, 6, 0.1), []
    for limit in (22, 24, 26, 28):
        inside = columns["i"] < limit
        z, quiescent = columns["z"][inside], columns["gal_type"][inside].mean()
        early = (columns["bulge_frac"][inside] > 0.5).mean()
        rows.append([limit, f"{np.median(z):.2f}", f"{quiescent:.3f}", f"{early:.3f}"])
        ax.hist(z, bins, density=True, histtype="step", label=f"i < {limit}")
    record.table("redshifts", ["i <", "median z", "quiescent", "bulge above half of the light"], rows)
    ax.set(xlabel="z")
    ax.legend(fontsize=6)


def draw_colours(two: plt.Axes, by_z: plt.Axes, columns: Columns, m: Columns) -> None:
    shown = (columns["i"] < 23) & (columns["z"] < 1.5)
    picture = two.scatter((m["g"] - m["r"])[shown], (m["u"] - m["g"])[shown], c=columns["z"][shown], s=1, cmap="turbo")
    plt.colorbar(picture, ax=two, label="z")
    two.set(xlabel="g - r", ylabel="u - g", xlim=(-0.3, 2.1), ylim=(-0.5, 4), title="i < 23, z < 1.5")
    shown = columns["i"] < 24.5
    kind = columns["gal_type"] == 1
    for keep, colour in ((~kind & shown, "b"), (kind & shown, "r")):
        by_z.plot(columns["z"][keep], (m["g"] - m["i"])[keep], ".", color=colour, ms=1)
    by_z.set(xlabel="z", ylabel="g - i", xlim=(0, 4), ylim=(-0.5, 4), title="i < 24.5; red: quiescent")


def compare_cosmos(record: Record, path: Path, columns: Columns, m: Columns) -> None:
    """Record medians by z magnitude of a box of COSMOS2020, and ours."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    column = {name: np.asarray(table[name].to_numpy(), float) for name in table.column_names}
    galaxy = (column["lp_type"] == 0) & (column["flux_r_uJy"] > 0) & (column["flux_z_uJy"] > 0)
    r, z = (23.9 - 2.5 * np.log10(column[f"flux_{band}_uJy"][galaxy]) for band in "rz")
    size = np.sqrt(np.maximum(column["flux_radius_arcsec"][galaxy] ** 2 - GROUND**2, 0.0))
    half = galaxy_sample.half_light(columns)
    bands = (*(PUBLISHED["r_z"][band] for band in "rz"), VISTA_Y)
    hsc_r, hsc_z, vista = (galaxy_sample.top_hat(columns, *edges) for edges in bands)
    r_z, z_y = hsc_r - hsc_z, hsc_z - vista
    flux = {band: np.where(column[f"flux_{band}_uJy"] > 0, column[f"flux_{band}_uJy"], np.nan)[galaxy] for band in "zY"}
    real_z_y = -2.5 * np.log10(flux["z"] / flux["Y"])
    ratio = column["acs_b_arcsec"][galaxy] / column["acs_a_arcsec"][galaxy]
    e = np.hypot(columns["e1"], columns["e2"])
    pairs = {"r - z": (r - z, r_z), "z - Y": (real_z_y, z_y), "radius": (size, half),
             "axis ratio": (ratio, (1 - e) / (1 + e))}  # fmt: skip
    rows = []
    for mag in range(20, 26):
        real, ours = np.abs(z - mag) < 0.5, np.abs(m["z"] - mag) < 0.5
        rows.append([mag, *(f"{np.nanmedian(v):.2f}" for a, b in pairs.values() for v in (a[real], b[ours]))])
    header = [word for name in pairs for word in (f"{name}, COSMOS2020", "ours")]
    record.table("cosmos", ["z [AB]", *header], rows)


def compare_hst(record: Record, path: Path, columns: Columns, even: Columns, weight: np.ndarray) -> None:
    """Record radii and redshifts of GalSim's example of the COSMOS sample (F814W, circle of equal area), and ours."""
    data = fits.getdata(path)
    i, radii = np.float64(data["mag_auto"]), np.float64(data["hlr"][:, 0])  # of the Sersic fit, freed of the PSF
    rows = []
    for low, high in ((20, 21.5), (21.5, 22.5)):
        real, here = np.log(radii[(i > low) & (i < high)]), (even["i"] > low) & (even["i"] < high)
        ours, _ = weighted_median(galaxy_sample.half_light(select(even, here)), weight[here])
        error = 1.25 * np.std(real) / np.sqrt(len(real))
        rows.append([f"{low:g} to {high:g}", f'{np.exp(np.median(real)):.3f}" ± {error:.0%}', f'{ours:.3f}"'])
    record.table("radii", ["i", "median radius, HST", "ours"], rows)
    real = np.float64(data["zphot"])[(i > 20.5) & (i < 22.5)]
    ours = columns["z"][(columns["i"] > 20.5) & (columns["i"] < 22.5)]
    record.value("z_hst", np.median(real), f"median photometric redshift of {len(real)} HST galaxies, 20.5 < i < 22.5")
    record.value("z_ours", np.median(ours), "the same of ours")


def compare_samples(record: Record, folder: Path, columns: Columns, even: Columns, weight: np.ndarray) -> None:
    bright = select(columns, columns["i"] < 26.5)
    missing = [name for name in (COSMOS_FILE, HST_FILE) if not (folder / name).exists()]
    if missing:
        record.skip(", ".join(missing), f"not in {folder}")
        for name in ("cosmos", "radii"):
            record.table(name, ["not compared"], [])
        return
    compare_cosmos(record, folder / COSMOS_FILE, bright, galaxy_sample.magnitudes(bright, "z"))
    compare_hst(record, folder / HST_FILE, columns, even, weight)


def main(record: Record) -> None:
    plt.switch_backend("Agg")
    begin = time.process_time()
    galaxy_sample.population()
    record.value("set_up", time.process_time() - begin, "set-up of the population", unit="CPU-s")
    area = TOY_AREA if record.toy else AREA
    begin = time.process_time()
    columns = galaxy_sample.sample(area)
    count = len(columns["i"])
    record.value("drawn", time.process_time() - begin, f"drawing {count:,} galaxies on {area:g} deg2", unit="CPU-s")
    even, weight = even_sample(TOY_EACH if record.toy else EACH)
    if record.options.samples:
        compare_samples(record, record.options.samples, columns, even, weight)
        return
    figure, axes = plt.subplots(2, 4, figsize=(17, 8), layout="constrained")
    (counts, masses, size, redshift), (two, by_z, red, shapes) = axes
    report_counts(record, counts, even, weight)
    report_medians(record, red, even, weight)
    report_lines(record)
    mass_functions(masses, even, weight)
    report_sizes(record, size, columns)
    report_redshifts(record, redshift, columns)
    bright = select(columns, columns["i"] < 26.5)
    draw_colours(two, by_z, bright, galaxy_sample.magnitudes(bright, "ugri"))
    e = np.hypot(bright["e1"], bright["e2"])
    for keep, name in ((bright["bulge_frac"] <= 0.5, "discs"), (bright["bulge_frac"] > 0.5, "B/T > 0.5")):
        shapes.hist(e[keep], 60, density=True, histtype="step", label=name)
    shapes.set(xlabel="|e| = (a - b)/(a + b)")
    shapes.legend(fontsize=6)
    figure.savefig(record.figure("galaxies.png"), dpi=80)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=Path, help="folder of real samples; only these are compared")
    with Record(parser) as record:
        main(record)
