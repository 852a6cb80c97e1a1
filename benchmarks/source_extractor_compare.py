"""Compare the catalogues of two codes on the same frames with the truth, for benchmarks/source_extractor.py."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from csstsim.base.files.atomic import atomic_path
from csstsim.measure.bricks.validation.compare import spread
from csstsim.measure.bricks.validation.measured_frame import EDGE, MeasuredFrame
from csstsim.measure.bricks.validation.trials import joined, matched, trials
from csstsim.measure.source_columns import SHARP

CODES = "csstsim", "source-extractor"
EDGES = (3, 4, 5, 6, 7, 8, 10, 20, 500)  # of true S/N
JUDGED, BRIGHT = (5.0, 500.0), (20.0, 500.0)  # S/N for completeness; for magnitudes and positions
COMPLETENESS_OFF, ZEROPOINT_OFF = 0.02, 0.02  # largest allowed differences of the two; the latter in mag


@dataclass
class Code:
    """One code's results for the frames of a band, one list entry per frame.

    tried: validation.trials (the same rows for both codes); kron: their Kron light over true electrons; snr: the
    S/N that the code gives to each detection; real: whether it matches a true object; fwhm: of its PSF [px]; cpu:
    {step: seconds}.
    """

    tried: list = field(default_factory=list)
    kron: list = field(default_factory=list)
    snr: list = field(default_factory=list)
    real: list = field(default_factory=list)
    fwhm: list = field(default_factory=list)
    cpu: list = field(default_factory=list)

    def add(self, truth, frame, fwhm, cpu):
        """Add a frame (validation.measured_frame.MeasuredFrame) and its judged truth."""
        table = frame.measured
        self.tried.append(trials(truth, frame))
        kron = MeasuredFrame(frame.truth, table.with_columns(flux_psf=table["flux_kron"]), frame.seam, frame.pixel)
        self.kron.append(trials(truth, kron)["light"])
        snr, real = detections(frame)
        self.snr.append(snr)
        self.real.append(real)
        self.fwhm.append(fwhm)
        self.cpu.append(cpu)


def detections(frame):
    """Return (stated S/N, whether it matches a true object) of each detection well inside the frame.

    Those flagged as sharp, cosmic rays, are left out, as by the merge.
    """
    truth, table, (x0, x1, y0, y1) = frame.truth, frame.measured, frame.info["window"]
    table = table.take((table["flags"] & SHARP) == 0)
    inside = (table["x"] > x0 + EDGE) & (table["x"] < x1 - EDGE)
    table = table.take(inside & (table["y"] > y0 + EDGE) & (table["y"] < y1 - EDGE))
    real = np.zeros(len(table), bool)
    if len(table):
        row = matched(truth, table, frame.pixel)
        real[row[row >= 0]] = True
    return table["snr"], real


def chosen(tried, limits, galaxy=False):
    """Return a mask of the stars (or galaxies) within limits of S/N."""
    return (tried["galaxy"] == galaxy) & (tried["snr"] > limits[0]) & (tried["snr"] < limits[1])


def magnitudes(light):
    """Return measured minus true magnitudes; NaN where the measured light is not positive."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return -2.5 * np.log10(np.where(light > 0, light, np.nan))


def numbers(code):
    """Return {row of the table: text} of a code."""
    tried, kron = joined(code.tried), magnitudes(np.concatenate(code.kron))
    snr, real = np.concatenate(code.snr), np.concatenate(code.real)
    rows = {"detections": f"{len(snr)}", "of S/N > 5 as it says": f"{(snr > 5).sum()}"}
    for name, some in (("all", snr > -np.inf), ("of S/N > 5 as it says", snr > 5)):
        rows["purity, " + name] = f"{100 * real[some].mean():.1f}%" if some.any() else "-"
    for low, high in (*pairwise(EDGES), JUDGED):
        some = chosen(tried, (low, high))
        share = f"{100 * tried['found'][some].mean():.1f}% of {some.sum()}" if some.any() else "-"
        rows[f"point sources found, S/N {low:g} - {high:g}"] = share
    star, galaxy = (chosen(tried, BRIGHT, some) & (tried["sound"] > 0) for some in (False, True))
    rows["stars' magnitudes, PSF"] = shown(magnitudes(tried["light"])[star], 4)
    rows["stars' magnitudes, Kron"] = shown(kron[star], 4)
    rows["galaxies' magnitudes, Kron"] = shown(kron[galaxy], 4)
    for name, text in (("across_mas", "stars' x [mas]"), ("deferred_mas", "stars' y [mas], from the amplifier")):
        rows[text] = shown(tried[name][star], 2)
    rows["FWHM of the PSF model [px]"] = ", ".join(f"{value:.3f}" for value in code.fwhm)
    for name in code.cpu[0]:
        rows[f"CPU s a frame, {name}"] = f"{np.mean([cpu[name] for cpu in code.cpu]):.1f}"
    return rows


def shown(values, digits):
    """Return median, its error and the scatter of values as text."""
    seen = spread(values[np.isfinite(values)])
    if not seen["n"]:
        return "-"
    return "{median:.{d}f} +- {error:.{d}f}, scatter {sigma:.{d}f} ({n})".format(**seen, d=digits)


def verdicts(ours, theirs, header):
    """Return [(what, difference, most allowed)] of a band. header: the error of MAGZERO by each star."""
    one, other = joined(ours.tried), joined(theirs.tried)
    some = chosen(one, JUDGED)
    first, second = one["found"][some] > 0, other["found"][some] > 0
    n = max(int(some.sum()), 1)
    chance = 2.0 * np.sqrt((first != second).sum()) / n
    star = chosen(one, BRIGHT) & (one["sound"] > 0) & (other["sound"] > 0)
    difference = magnitudes(one["light"])[star] - magnitudes(other["light"])[star]
    return [
        ("completeness, S/N > 5", (first.sum() - second.sum()) / n, COMPLETENESS_OFF + chance),
        ("zero point, star by star [mag]", _median(difference), ZEROPOINT_OFF),
        ("zero point of the file, MAGZERO, less that of the truth [mag]", _median(header), ZEROPOINT_OFF),
    ]


def _median(values):
    """Return the median of the finite values; infinity without any, so that a missing comparison does not pass."""
    values = np.asarray(values, float)
    return float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else np.inf


def report(band, ours, theirs, header, record):
    """Record a band's table and verdicts. record: evidence.record.Record."""
    columns = [numbers(code) for code in (ours, theirs)]
    names = dict.fromkeys([*columns[0], *columns[1]])
    rows = [[name, *(column.get(name, "") for column in columns)] for name in names]
    record.table(f"{band}_codes", [band, *CODES], rows)
    keys = "completeness", "zeropoint", "file_zeropoint"
    for key, (what, difference, most) in zip(keys, verdicts(ours, theirs, header), strict=True):
        value = difference if np.isfinite(difference) else "nothing to compare"
        record.value(f"{band}_{key}", value, f"{band}: {what}, ours less theirs", goal=abs(difference) <= most)


def draw(path, bands):
    """Write the figure (PNG): completeness and residuals of both codes. bands: {filter: (Code, Code, ...)}."""
    figure = Figure(figsize=(4.6 * len(bands), 6.4), layout="constrained")
    axes = figure.subplots(2, len(bands), sharey="row", squeeze=False)
    edges = np.array([1.5, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 30])
    for column, (band, codes) in zip(axes.T, bands.items(), strict=True):
        for code, name, colour, marker in zip(codes, CODES, ("#0b6e99", "#b5542d"), "ox", strict=False):
            tried = joined(code.tried)
            points = tried["galaxy"] == 0
            n, seen = (np.histogram(tried["snr"][some], edges)[0] for some in (points, points & (tried["found"] > 0)))
            share, middle = seen / np.maximum(n, 1), np.sqrt(edges[1:] * edges[:-1])
            error = np.sqrt(share * (1 - share) / np.maximum(n, 1))
            column[0].errorbar(
                middle[n > 0], share[n > 0], error[n > 0], fmt=marker + "-", color=colour, ms=5, lw=1, label=name
            )
            some = points & (tried["sound"] > 0) & (tried["snr"] > JUDGED[0]) & (tried["snr"] < JUDGED[1])
            residual = magnitudes(tried["light"])[some]
            column[1].plot(tried["snr"][some], residual, marker, color=colour, ms=3, mew=0.8, alpha=0.6, label=name)
        column[0].axvline(JUDGED[0], color="0.7", lw=0.8)
        column[0].set(xscale="log", xlabel="true S/N", title=band, ylim=(0, 1.05), xlim=(1.5, 30))
        column[0].set_xticks([2, 3, 5, 10, 20], [2, 3, 5, 10, 20])
        column[0].minorticks_off()
        column[1].axhspan(-ZEROPOINT_OFF, ZEROPOINT_OFF, color="0.9", zorder=0)
        column[1].set(xscale="log", xlabel="true S/N", ylim=(-0.4, 0.4))
        column[1].set_xticks([5, 10, 20, 50, 100, 200, 500], [5, 10, 20, 50, 100, 200, 500])
        column[1].minorticks_off()
    axes[0, 0].set_ylabel("fraction of isolated point sources found")
    axes[1, 0].set_ylabel("PSF magnitude, measured - true")
    axes[0, 0].legend()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=100, format="png")
