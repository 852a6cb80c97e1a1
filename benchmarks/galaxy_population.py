"""The embedded universe's galaxies against published counts, mass functions, sizes, colours and redshifts.

    PYTHONPATH=tests:builders python benchmarks/galaxy_population.py [--data ../shared/data]

Prints tables and draws docs/figures/galaxies.png. Two samples are used: galaxies placed evenly over mass and redshift,
each representing a number per deg2 (so that rare ones have counts and mass functions, too), and galaxies drawn on 0.04
deg2. Real samples, if the data folder exists: a box of COSMOS2020 (Weaver et al. 2022) and 100 HST galaxies (GalSim's
COSMOS sample).
"""

import argparse
import os
import time
from pathlib import Path

import galaxy_sample
import matplotlib.pyplot as plt
import numpy as np

from csstsim.base.rng import stream
from csstsim.instrument.load import read_data
from csstsim.universe.galaxies.galaxies import cumulative_counts

ROOT = Path(__file__).resolve().parents[1]
TARGET = ROOT / "docs" / "figures" / "galaxies.png"
PUBLISHED = read_data(ROOT / "tests" / "universe" / "published_galaxies.yaml")
AREA = 0.04  # deg2 drawn
EACH = 12  # galaxies of a cell of the even sample
VISTA_Y = (9740, 10660)  # angstrom, half-power points
GROUND = 0.38  # arcsec: flux radius of stars in the COSMOS2020 box, subtracted in quadrature
COLOURS = (("nuv", "u"), ("u", "g"), ("g", "i"), ("r", "i"), ("i", "z"), ("z", "y"))


def even_sample():
    """Return columns of galaxies, and the number per deg2 that each represents."""
    model = galaxy_sample.population()
    cells = np.repeat(np.argwhere(model.grid.density > 0), EACH, axis=0).T
    columns = model.properties(lambda name: stream(2, name), *model.grid.place(stream(2, "place"), *cells))
    return columns, model.grid.density[tuple(cells)] / EACH


def select(columns, keep):
    return {name: values[keep] for name, values in columns.items()}


def counts_table(ax, columns, weight):
    mag, total = cumulative_counts(galaxy_sample.numbers())
    columns, weight = select(columns, columns["i"] < 29), weight[columns["i"] < 29]
    m = galaxy_sample.magnitudes(columns)
    centre = np.arange(16.5, 27.1, 1.0)
    edges = np.append(centre - 0.5, centre[-1] + 0.5)
    print("counts, deg-2 mag-1\n   mag   i wanted" + "".join(f"{band:>9}" for band in m))
    counts = {band: np.histogram(values, edges, weights=weight)[0] for band, values in m.items()}
    wanted = np.diff(np.interp(edges, mag, total))
    for k, c in enumerate(centre):
        print(f"{c:6.1f} {wanted[k]:10.0f}" + "".join(f"{counts[band][k]:9.0f}" for band in m))
    slope = np.polyfit(centre[4:8], np.log10(counts["g"][4:8]), 1)[0]
    print(f"g slope 20.5-23.5: {slope:.2f} dex/mag (B: 0.50 at 20-24, flattening fainter)")
    limit = mag[-1]
    print(f"limit i = {limit:.2f} gives {total[-1] / 3600:.0f} arcmin-2")
    ax.semilogy(mag, np.gradient(total, mag), "k-", lw=0.8, label="i wanted")
    for band, colour in (("nuv", "m"), ("u", "b"), ("g", "c"), ("i", "r"), ("y", "brown")):
        ax.semilogy(centre, counts[band], ".-", color=colour, ms=4, lw=0.7, label=band)
    beside_published(m, weight)
    beside_hsc(ax, columns, weight, m["i"])
    beside_surveys(columns, weight, m["i"])
    real = np.array(PUBLISHED["i_counts"])
    ax.semilogy(real[:, 0], 10 ** real[:, 1], "ro", mfc="none", label="i, Weaver+ 2022")
    u = np.array(PUBLISHED["u_counts"])
    ax.semilogy(u[:, 0], 10 ** u[:, 1], "bs", mfc="none", label="U, Grazian+ 2009")
    ax.set(xlabel="AB mag", ylabel="deg$^{-2}$ mag$^{-1}$", xlim=(16, 29), ylim=(3, 1e6))
    ax.legend(fontsize=6)
    print("U_AB  log N published, csstsim's:")
    for mag_u, log in PUBLISHED["u_counts"]:
        found = np.log10(weight[np.abs(m["u"] - mag_u) < 0.5].sum())
        print(f"{mag_u:6.2f} {log:6.2f} {found:6.2f}")


def beside_published(m, weight):
    """Print counts in half magnitudes beside those of COSMOS2020, and numbers brighter than limits in r."""
    i, cosmos = dict(PUBLISHED["i_counts"]), {mag: (r, z) for mag, r, z in PUBLISHED["cosmos"]}
    print("   mag  log N, found - published (COSMOS2020): i, r, z")
    for mag in i:
        found = {band: np.log10(weight[np.abs(m[band] - mag) < 0.25].sum() / 0.5) for band in "irz"}
        r, z = cosmos.get(mag, (np.nan, np.nan))
        print(f"{mag:6.2f}  {found['i'] - i[mag]:+.2f} {found['r'] - r:+.2f} {found['z'] - z:+.2f}")
    for limit, number in PUBLISHED["r_cumulative"]:
        print(f"r < {limit}: {weight[m['r'] < limit].sum():.0f} deg-2; published {number}")


def beside_hsc(ax, columns, weight, i):
    """Print counts in HSC's bands over those of HSC, and over them the same ratio in i; draw HSC's in g and y."""
    hsc, found = PUBLISHED["hsc_counts"], {}
    edges, keep = np.array(hsc["edges"]), i < 27
    columns, weight = select(columns, keep), weight[keep]
    level = i[keep] - galaxy_sample.top_hat(columns, *hsc["bands"]["i"])  # of the bands' magnitudes, the same for all
    for band, limits in hsc["bands"].items():
        magnitude = galaxy_sample.top_hat(columns, *limits) + np.median(level)
        found[band] = np.histogram(magnitude, edges, weights=weight)[0] / np.diff(hsc[band])
    print("mag  ours / HSC in " + " ".join(found) + "; the same over that in i")
    for k, low in enumerate(edges[:-1]):
        print(f"{low:g}-{low + 1:g}  " + " ".join(f"{v[k]:5.2f}" for v in found.values()) + "   "
              + " ".join(f"{v[k] / found['i'][k]:5.2f}" for v in found.values()))  # fmt: skip
    for band, colour in (("g", "c"), ("y", "brown")):
        ax.semilogy(edges[:-1] + 0.5, np.diff(hsc[band]), "x", color=colour, ms=4, label=f"{band}, HSC")


def beside_surveys(columns, weight, i):
    """Print counts in half magnitudes over those of GAMA, of COSMOS in other catalogues, and of HST, in their bands."""
    keep = i < 28
    columns, weight = select(columns, keep), weight[keep]
    level = np.median(i[keep] - galaxy_sample.top_hat(columns, *PUBLISHED["hsc_counts"]["bands"]["i"]))
    for survey, band, limits, rows in PUBLISHED["survey_counts"]:
        magnitude = galaxy_sample.top_hat(columns, *limits) + level
        ratios = [weight[np.abs(magnitude - mag) < 0.25].sum() / number for mag, number in rows]
        told = "  ".join(f"{mag:g}: {ratio:.2f}" for (mag, _), ratio in zip(rows, ratios, strict=True))
        print(f"ours / {survey} {band}  {told}")


def weighted_median(values, weight):
    """Return the median of `values` and its error, each value counted `weight` times."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    low, middle, high = np.interp(np.array([0.16, 0.5, 0.84]) * total[-1], total, values[order])
    effective = weight.sum() ** 2 / (weight**2).sum()
    return middle, 1.25 * 0.5 * (high - low) / np.sqrt(effective)


def medians(columns, weight):
    """Print median colours beside COSMOS2020 and the Hubble Deep Field, and radii, all by magnitude."""
    keep = columns["i"] < 27
    columns, weight = select(columns, keep), weight[keep]
    m, half = galaxy_sample.magnitudes(columns), galaxy_sample.half_light(columns)
    m["nuv"] = np.minimum(m["nuv"], 99.0)  # no light below the Lyman limit

    def near(band, mag, values):
        here = np.abs(m[band] - mag) < 0.5
        return weighted_median(values[here], weight[here])

    print(" i    " + "   ".join(f"{a} - {b}" for a, b in COLOURS) + "   radius   (error of g - i)")
    for mag in range(20, 27):
        found = [near("i", mag, m[a] - m[b]) for a, b in COLOURS] + [near("i", mag, half)]
        print(f"{mag}  " + "   ".join(f"{v:6.3f}" for v, _ in found) + f"   ({found[2][1]:.3f})")
    real = PUBLISHED["r_z"]
    r_z = np.subtract(*(galaxy_sample.top_hat(columns, *real[band]) for band in "rz"))  # HSC's bands
    for mag, colour in real["medians"]:
        ours, error = near("z", mag, r_z)
        print(f"r - z at z = {mag}: {ours:.2f} +- {error:.2f}; COSMOS2020 {colour:.2f}")
    real = PUBLISHED["hubble_deep_field"]
    colour = np.subtract(*(galaxy_sample.top_hat(columns, *real[band]) for band in ("f450w", "f814w")))
    for mag, published, sigma in real["medians"]:
        ours, error = near("i", mag, colour)
        print(f"F450W - F814W at {mag}: {ours:.2f} +- {error:.2f}; Hubble Deep Field {published:.2f} +- {sigma:.2f}")


def line_widths():
    """Print rest-frame equivalent widths of Halpha with [NII] by mass and redshift, beside those by rate."""
    published = PUBLISHED["line_widths"]
    print("Halpha + [NII] [A], log M 9, 9.5, 10, 10.5, 11; at 10 of its rate, published beyond z = 1")
    for z in (0.1, 0.35, 0.5, *published["z"]):
        found = [galaxy_sample.line_width(z, m, 6510, 6630) for m in (9.0, 9.5, published["log_mass"], 10.5, 11.0)]
        widths = " ".join(f"{width:5.0f}" for width, _ in found)
        print(f"z = {z}: {widths}; {published['per_rate'][0] * found[2][1]:.0f}")


def mass_functions(ax, columns, weight):
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


def sizes(ax, columns, hst, even, weight):
    half = galaxy_sample.half_light(columns)
    e = np.hypot(columns["e1"], columns["e2"])
    axis = half * np.sqrt((1 + e) / (1 - e))
    print(
        "half-light radius of the circle of equal area, arcsec; median semi-major axis, and that of Miller et al. 2013"
    )
    print(" i   csstsim: 16, 50, 84%   axis  Miller")
    centre = np.arange(19, 30)
    rows = [np.percentile(half[np.abs(columns["i"] - m) < 0.5], [16, 50, 84]) for m in centre]
    miller = 1.678347 * np.exp(-1.145 - 0.269 * (centre - 23))
    for m, row, a in zip(centre, rows, miller, strict=True):
        long = np.median(axis[np.abs(columns["i"] - m) < 0.5])
        print(f"{m:3d}  " + " ".join(f"{r:6.3f}" for r in row) + f"  {long:6.3f} {a:6.3f}")
    ax.fill_between(centre, *np.transpose(rows)[[0, 2]], color="0.8")
    ax.semilogy(centre, np.transpose(rows)[1], "k-", label="csstsim: median, 68%")
    ax.semilogy(
        centre, [np.median(axis[np.abs(columns["i"] - m) < 0.5]) for m in centre], "k:", label="semi-major axis"
    )
    ax.semilogy(centre, miller, "r--", label="axis, Miller+ 2013")
    if hst:
        ax.semilogy(hst["i"], hst["hlr"], "b.", ms=3, label="HST, 100 galaxies")
        for low, high in ((20, 21.5), (21.5, 22.5)):
            real = np.log(hst["hlr"][(hst["i"] > low) & (hst["i"] < high)])
            here = (even["i"] > low) & (even["i"] < high)
            ours, _ = weighted_median(galaxy_sample.half_light(select(even, here)), weight[here])
            error = 1.25 * np.std(real) / np.sqrt(len(real))
            print(
                f"HST {low} < i < {high}: median {np.exp(np.median(real)):.3f} +- {100 * error:.0f}%; ours {ours:.3f}"
            )
    ax.set(xlabel="i", ylabel="half-light radius [arcsec]", xlim=(18, 30))
    ax.legend(fontsize=6)


def redshifts(ax, columns, hst):
    bins = np.arange(0, 6, 0.1)
    for limit in (22, 24, 26, 28):
        inside = columns["i"] < limit
        z, quiescent = columns["z"][inside], columns["gal_type"][inside].mean()
        early = (columns["bulge_frac"][inside] > 0.5).mean()
        print(f"i < {limit}: median z {np.median(z):.2f}, quiescent {quiescent:.3f}, B/T > 0.5 {early:.3f}")
        ax.hist(z, bins, density=True, histtype="step", label=f"i < {limit}")
    if hst:
        ours = columns["z"][(columns["i"] > 20.5) & (columns["i"] < 22.5)]
        real = hst["z"][(hst["i"] > 20.5) & (hst["i"] < 22.5)]
        print(f"20.5 < i < 22.5: median z {np.median(ours):.2f}; HST photometric {np.median(real):.2f} ({len(real)})")
    ax.set(xlabel="z")
    ax.legend(fontsize=6)


def colours(two, by_z, columns, m):
    shown = (columns["i"] < 23) & (columns["z"] < 1.5)
    picture = two.scatter((m["g"] - m["r"])[shown], (m["u"] - m["g"])[shown], c=columns["z"][shown], s=1, cmap="turbo")
    plt.colorbar(picture, ax=two, label="z")
    two.set(xlabel="g - r", ylabel="u - g", xlim=(-0.3, 2.1), ylim=(-0.5, 4), title="i < 23, z < 1.5")
    shown = columns["i"] < 24.5
    kind = columns["gal_type"] == 1
    for keep, colour in ((~kind & shown, "b"), (kind & shown, "r")):
        by_z.plot(columns["z"][keep], (m["g"] - m["i"])[keep], ".", color=colour, ms=1)
    by_z.set(xlabel="z", ylabel="g - i", xlim=(0, 4), ylim=(-0.5, 4), title="i < 24.5; red: quiescent")


def cosmos(ax, path, columns, m):
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
    print(
        "z mag  r - z COSMOS 16, 50, 84%   csstsim, HSC bands  half-light COSMOS, own    axis ratio COSMOS (ACS), own"
        "    z - Y COSMOS, own"
    )
    for mag in range(20, 26):
        real, ours = np.abs(z - mag) < 0.5, np.abs(m["z"] - mag) < 0.5
        print(f"{mag:4d}  " + "  ".join(
            " ".join(f"{v:6.2f}" for v in np.percentile(c, [16, 50, 84]))
            for c in ((r - z)[real], r_z[ours])
        ) + f"   {np.median(size[real]):8.2f} {np.median(half[ours]):6.2f}"
          f"      {np.nanmedian(ratio[real]):8.2f} {np.median((1 - e[ours]) / (1 + e[ours])):6.2f}"
          f"     {np.nanmedian(real_z_y[real]):8.2f} {np.median(z_y[ours]):6.2f}")  # fmt: skip
    bins = np.arange(-0.5, 3, 0.05)
    for mag, colour in ((21, "r"), (24, "b")):
        ax.hist((r - z)[np.abs(z - mag) < 0.5], bins, density=True, histtype="stepfilled", color=colour, alpha=0.25)
        ours = np.abs(m["z"] - mag) < 0.5
        ax.hist(r_z[ours], bins, density=True, histtype="step", color=colour, label=f"z = {mag}")
    ax.set(xlabel="r - z", title="lines: csstsim; filled: COSMOS2020")
    ax.legend(fontsize=6)


def hst_sample(path):
    """Return {i, hlr [arcsec], z} of GalSim's example of the COSMOS sample: F814W, circle of equal area."""
    from astropy.io import fits

    data = fits.getdata(path)
    i, hlr = np.float64(data["mag_auto"]), np.float64(data["hlr"][:, 0])  # of the Sersic fit, freed of the PSF
    return {"i": i, "hlr": hlr, "z": np.float64(data["zphot"])}


def main():
    plt.switch_backend("Agg")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("CSSTSIM_DATA", ROOT.parent / "shared" / "data"))
    folder = Path(parser.parse_args().data) / "galaxies"
    figure, axes = plt.subplots(2, 4, figsize=(17, 8), layout="constrained")
    (counts, masses, size, redshift), (two, by_z, real, shapes) = axes
    begin = time.process_time()
    galaxy_sample.population()
    print(f"set-up {time.process_time() - begin:.1f} CPU-s")
    begin = time.process_time()
    columns = galaxy_sample.sample(AREA)
    print(f"{len(columns['i'])} galaxies on {AREA} deg2: {time.process_time() - begin:.1f} CPU-s")
    path = folder / "galsim_real_galaxy_catalog_23.5_example_fits.fits"
    hst = hst_sample(path) if path.exists() else None
    counts_table(counts, *(sample := even_sample()))
    medians(*sample)
    line_widths()
    mass_functions(masses, *sample)
    sizes(size, columns, hst, *sample)
    redshifts(redshift, columns, hst)
    bright = select(columns, columns["i"] < 26.5)
    m = galaxy_sample.magnitudes(bright)
    colours(two, by_z, bright, m)
    path = folder / "cosmos2020_box0p25deg2.parquet"
    if path.exists():
        cosmos(real, path, bright, m)
    e = np.hypot(bright["e1"], bright["e2"])
    for keep, name in ((bright["bulge_frac"] <= 0.5, "discs"), (bright["bulge_frac"] > 0.5, "B/T > 0.5")):
        shapes.hist(e[keep], 60, density=True, histtype="step", label=name)
    shapes.set(xlabel="|e| = (a - b)/(a + b)")
    shapes.legend(fontsize=6)
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(TARGET, dpi=80)
    print(TARGET)


if __name__ == "__main__":
    main()
