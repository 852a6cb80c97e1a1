"""Compare a brick's measurements with its truth: the checks of the paper's section 6, as numbers and gates.

Completeness of point sources against their true S/N, magnitudes out minus in (PSF for stars, Kron for
galaxies), astrometric residuals, and the u-g, g-r colours of input and output. The true S/N is that of
optimal photometry, F / sqrt(F + n_eff rms^2), with F the electrons of the truth and the frame's own noise.
Completeness counts every exposure of a source by itself; the rest is judged on the merged catalogue.
Blended and (nearly) saturated sources are left out; a figure from fewer than `FEW` sources judges nothing.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.bricks import compare
from csstsim.bricks.healpix import brick_of, from_vectors, to_vectors
from csstsim.catalog.flags import BAD_VALUE, OFF_CHIP, STRONG_LENSING
from csstsim.catalog.table import BANDS, GALAXY, ObjectTable

SNR_EDGES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 15, 20, 50, 100, 500)
EDGE = 12  # px; sources nearer to the frame's edge are not judged
MATCH_PX = 2.5  # truth and detection in one frame
IN_FRAME = 0.9  # of an object's light in the window; less is not judged
FEW = 20


@dataclass(frozen=True)
class Frame:
    """One measured Level-0 file: its truth (io.truth.read_truth) and its measured table (measure.catalogue)."""

    truth: ObjectTable
    measured: ObjectTable

    @property
    def info(self):
        return self.measured.meta

    @property
    def band(self):
        return self.info["filter"].lower()


def validate_brick(pix, sources, frames, config):
    """Return (result, arrays) of brick `pix`.

    `sources`: merged ObjectTable (or mapping) of the brick; `frames`: iterable of `Frame`; `config`:
    config.ValidateConfig. `result` is JSON-like: per band completeness, magnitude residuals (mag), depth;
    astrometry (mas); gates [{name, band, value, threshold, n, passed}], passed None when nothing can be said.
    `arrays` holds what bricks.figures draws.
    """
    trials = {band: [] for band in BANDS}
    infos = {band: [] for band in BANDS}
    kept, everything = [], []
    for frame in frames:
        everything.append(frame.truth)
        infos[frame.band].append(frame.info)
        truth = _usable(pix, frame)
        if len(truth):
            trials[frame.band].append(_trial(truth, frame))
            kept.append(truth)
    truth = _unique(kept)
    match = compare.match(truth, sources)
    bands, curves, residuals, gates = {}, {}, {}, []
    for band in BANDS:
        if not infos[band]:
            continue
        snr, found = np.concatenate(trials[band], axis=1) if trials[band] else np.zeros((2, 0))
        curves[band] = completeness(snr, found > 0, SNR_EDGES)
        residuals[band], numbers = compare.magnitudes(band, truth, sources, match, infos[band])
        judged = (snr > config.snr_min) & (snr < compare.SNR_MAX)
        fraction = float(found[judged].mean()) if judged.any() else None
        depth = [info["depth_5sigma"] for info in infos[band]]
        zeropoint = [info["zeropoint"] - 2.5 * np.log10(info["exptime"]) for info in infos[band]]
        n, seen = (counts.tolist() for counts in curves[band])
        bands[band] = numbers | {
            "frames": len(infos[band]), "depth_5sigma": float(np.median(depth)), "completeness": fraction,
            "zeropoint": float(np.median(zeropoint)), "point_sources": int(judged.sum()),
            "completeness_curve": {"snr": list(SNR_EDGES), "n": n, "found": seen},
        }  # fmt: skip
        star = numbers["star"]
        gates += [
            _gate("completeness", band, fraction, config.completeness_min, int(judged.sum()), at_least=True),
            _gate("magnitude bias of stars", band, star["median"], config.mag_bias_max, star["n"]),
        ]
    result = {
        "brick": int(pix), "sources": len(sources), "purity": compare.purity(sources, everything),
        "left_out": getattr(sources, "meta", {}).get("left_out"), "truth": len(truth),
        "frames": sum(map(len, infos.values())),
        "bands": bands, "astrometry_mas": compare.astrometry(truth, sources, match, bands), "gates": gates,
    }  # fmt: skip
    colour = compare.colours(truth, sources, match)
    return result, {"completeness": curves, "residual": residuals, "colour": colour}


def completeness(snr, found, edges):
    """Return (n, found) per bin of true S/N; `found` is a bool array."""
    return np.histogram(snr, edges)[0], np.histogram(snr[found], edges)[0]


def _usable(pix, frame):
    """The truth of a frame that lies in the brick and well inside the frame, with a `blended` column."""
    truth, (x0, x1, y0, y1) = frame.truth, frame.info["window"]
    truth = truth.take((truth["flags"] & (OFF_CHIP | STRONG_LENSING | BAD_VALUE)) == 0)
    if len(truth) == 0:
        return truth
    near = blended(truth["x"], truth["y"], truth["electrons"])
    truth = truth.with_columns(blended=near, half_light=compare.half_light(truth))
    inside = (truth["x"] > x0 + EDGE) & (truth["x"] < x1 - EDGE) & (truth["y"] > y0 + EDGE) & (truth["y"] < y1 - EDGE)
    inside = inside & (truth["electrons"] > 0)
    if "fraction" in truth:  # of photons it is what came, not what was to be expected
        inside = inside & ((truth["fraction"] > IN_FRAME) | (truth["method"] == "photons"))
    truth = truth.take(inside)
    return truth.take(brick_of(truth["ra_epoch"], truth["dec_epoch"]) == pix) if len(truth) else truth


def blended(x, y, electrons):
    """Return a mask of the objects with a neighbour that matters.

    One of more than 10 % of their flux within 12 px, or of more than 100 times within 40 px (wings).
    """
    from scipy.spatial import cKDTree

    mask = np.zeros(len(x), bool)
    tree = cKDTree(np.column_stack([x, y]))
    pairs = tree.query_pairs(40.0, output_type="ndarray")
    near = np.hypot(*(v[pairs[:, 0]] - v[pairs[:, 1]] for v in (x, y))) < 12.0
    for one, other in ((0, 1), (1, 0)):
        a, b = pairs[:, one], pairs[:, other]
        mask[a[electrons[b] > np.where(near, 0.1, 100.0) * electrons[a]]] = True
    return mask


def _trial(truth, frame):
    """(true S/N, found 0 or 1) of the isolated point sources of one frame, (2, n)."""
    from scipy.spatial import cKDTree

    points = truth.take((truth["obj_type"] != GALAXY) & ~truth["blended"])
    electrons = points["electrons"].astype(float)
    snr = electrons / np.sqrt(electrons + frame.info["n_eff"] * frame.info["rms"] ** 2)
    if len(points) == 0 or len(frame.measured) == 0:
        return np.stack([snr, np.zeros(len(points))])
    tree = cKDTree(np.column_stack([frame.measured["x"], frame.measured["y"]]))
    distance, _ = tree.query(np.column_stack([points["x"], points["y"]]))
    return np.stack([snr, distance < MATCH_PX])


def _unique(tables):
    """One row per object of the truth of several frames, by id; blended anywhere is blended, `ra_epoch` is the mean."""
    names = ("id", "obj_type", "ra_epoch", "dec_epoch", "blended", "half_light", *(f"mag_{band}" for band in BANDS))
    if not tables:
        return ObjectTable({name: np.zeros(0, bool if name == "blended" else float) for name in names})
    columns = {name: np.concatenate([table[name] for table in tables]) for name in names}
    _, first, which = np.unique(columns["id"], return_index=True, return_inverse=True)
    anywhere = np.bincount(which, columns["blended"]) > 0
    vectors = to_vectors(columns["ra_epoch"], columns["dec_epoch"])
    ra, dec = from_vectors(np.stack([np.bincount(which, v) for v in vectors.T], axis=1))
    table = ObjectTable({name: values[first] for name, values in columns.items()})
    return table.with_columns(blended=anywhere, ra_epoch=ra, dec_epoch=dec)


def _gate(name, band, value, threshold, n, *, at_least=False):
    passed = None
    if value is not None and threshold is not None and n >= FEW:
        # A fraction of n that truly is at the threshold falls short by chance: two sigma of it are forgiven
        chance = 2 * np.sqrt(threshold * (1 - threshold) / n) if at_least else 0.0
        passed = bool(value + chance >= threshold) if at_least else bool(abs(value) <= threshold)
    return {"name": name, "band": band, "value": value, "threshold": threshold, "n": n, "passed": passed}
