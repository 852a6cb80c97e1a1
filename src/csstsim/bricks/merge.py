"""Merge the detections of all exposures, chips and bands in one brick into one row per source (paper, section 6).

Detections closer than `TOLERANCE` are linked, and a linked group is one source; where a group holds two
detections of one frame, which are two sources, it is split around its brightest detections. The position
is the mean weighted with the inverse variance, and the brick that holds it owns the source: each brick
works on its detections plus a margin, so every source is in exactly one brick. The result does not
depend on the order of the input.

A source is kept when a detection has S/N >= `SNR_ALONE` (PSF, or Kron of a peak that the PSF sees with
`KRON_PSF_MIN`), or `VISITS_ALONE` frames have it, or two frames have it with a joint PSF S/N >= `SNR_PAIR`;
detections without a windowed position do not count. The threshold of `measure.detect` is lower, for
completeness, and lets noise peaks pass. Measured on the demo (14 frames of 3.8 Mpx): of 8057 linked groups 240
are kept, and no more than 18 of those have no true object. The number left out is in `meta` and in
the file ("left_out").
Left out: forced photometry in the bands without a detection (NaN), and motion: positions are ICRS at each exposure's
epoch, so a star that moves by more than the tolerance between exposures becomes two sources.
"""

import numpy as np

from csstsim.bricks.healpix import brick_of, from_vectors, hats_index, near_brick, to_vectors
from csstsim.catalog.table import BANDS, ObjectTable, write_parquet

TOLERANCE = 0.22  # arcsec, 3 px: 5 sigma of the windowed position at the detection limit
MARGIN = 2.0  # arcsec
AB_MICROJANSKY = 23.9  # AB magnitude of 1 microjansky
ARCSEC = np.pi / 180.0 / 3600.0
SNR_ALONE = 5.0  # a single detection of this S/N is a source
KRON_PSF_MIN = 2.5  # below, a Kron aperture holds but noise or a neighbour's light
VISITS_ALONE = 3  # as are detections in this many frames; chance makes three agree a few times a brick
SNR_PAIR = 6.3  # two noise peaks at the threshold of detection make 5.3
NOT_CENTRED, SHARP, BAD_PIXELS = 32, 64, 128  # of the measured flags (measure.catalogue)

DETECTION_COLUMNS = (
    "obsid", "chip", "filter", "number", "ra", "dec", "pos_err", "flux_psf", "flux_psf_err", "flux_kron",
    "flux_kron_err", "zeropoint", "snr", "star", "flags",
)  # fmt: skip


def merge_brick(pix, tables, *, tolerance=TOLERANCE, margin=MARGIN):
    """Return (sources, detections) of brick `pix`.

    `tables`: iterable of measured tables (measure.catalogue columns); those without a row in the brick or
    its margin cost nothing. `sources`: ObjectTable, one row per source the brick owns, in the order of
    `_healpix_29`: source_id, ra, dec (deg), pos_err (arcsec), for each band B flux_B, flux_err_B (PSF) and
    kron_flux_B, kron_flux_err_B in microjansky, mag_B, mag_err_B, kron_mag_B, kron_mag_err_B (AB; NaN where
    there is no positive flux), n_B; n_detections, star (0..1, S/N-weighted vote), flags (bits of any detection).
    `sources.meta` has the number of sources left out.
    `detections`: ObjectTable of DETECTION_COLUMNS and `source` (row in `sources`), sorted by it.
    """
    found = _gather(pix, tables, margin / 3600.0)
    vectors = to_vectors(found["ra"], found["dec"])
    source = _group(vectors, found, tolerance * ARCSEC)
    count = int(source.max(initial=-1)) + 1
    weight = 1.0 / np.maximum(found["pos_err"].astype(float), 1e-4) ** 2
    mean = np.stack([np.bincount(source, weight * vectors[:, axis], count) for axis in range(3)], axis=1)
    ra, dec = from_vectors(mean)
    inside = brick_of(ra, dec) == pix
    credible = _credible(found, source, count)
    owned = np.flatnonzero(inside & credible)
    index = hats_index(ra[owned], dec[owned])
    owned = owned[np.lexsort((dec[owned], ra[owned], index))]
    rank = np.full(count, -1)
    rank[owned] = np.arange(len(owned))
    keep = np.flatnonzero(rank[source] >= 0)
    keep = keep[np.argsort(rank[source[keep]], kind="stable")]
    detections = found.take(keep).with_columns(source=rank[source[keep]])
    columns = {
        "_healpix_29": hats_index(ra[owned], dec[owned]),
        "source_id": pix * 2**20 + np.arange(len(owned), dtype=np.int64),
        "ra": ra[owned], "dec": dec[owned],
        "pos_err": np.bincount(source, weight, count)[owned] ** -0.5,
    }  # fmt: skip
    columns |= _photometry(detections, len(owned))
    left_out = {
        "left_out": int((inside & ~credible).sum()), "snr_alone": SNR_ALONE, "visits_alone": VISITS_ALONE,
        "snr_pair": SNR_PAIR,
    }  # fmt: skip
    return ObjectTable(columns, left_out), detections


def _credible(found, source, count):
    """Mask of the sources (count,) that stand by the S/N of a good detection or by their number of those."""
    good = (found["flags"].astype(int) & (NOT_CENTRED | BAD_PIXELS)) == 0
    psf = np.where(good, np.maximum(found["snr"].astype(float), 0.0), 0.0)
    kron = found["flux_kron"] / np.where(found["flux_kron_err"] > 0, found["flux_kron_err"], np.inf)
    best = np.zeros(count)
    np.maximum.at(best, source, np.where(psf >= KRON_PSF_MIN, np.fmax(psf, kron), psf))
    visits, joint = np.bincount(source, good, count), np.bincount(source, psf**2, count) ** 0.5
    return (best >= SNR_ALONE) | (visits >= VISITS_ALONE) | ((visits >= 2) & (joint >= SNR_PAIR))


def _gather(pix, tables, margin):
    parts = []
    for table in tables:
        near = near_brick(pix, table["ra"], table["dec"], margin) if len(table) else np.zeros(0, bool)
        near &= (table["flags"] & SHARP) == 0  # a cosmic ray or a defect
        if near.any():
            parts.append({name: np.asarray(table[name])[near] for name in DETECTION_COLUMNS})
    empty = {name: np.zeros(0, str if name in ("obsid", "filter") else float) for name in DETECTION_COLUMNS}
    parts = parts or [empty | {name: np.zeros(0, np.int64) for name in ("chip", "number", "flags")}]
    found = ObjectTable({name: np.concatenate([part[name] for part in parts]) for name in DETECTION_COLUMNS})
    found = found.with_columns(obsid=found["obsid"].astype(str), filter=np.char.lower(found["filter"].astype(str)))
    # One fixed order, brightest first: nothing below depends on how the input came.
    return found.take(np.lexsort((found["number"], found["chip"], found["obsid"], -found["snr"].astype(float))))


def _group(vectors, found, radius):
    """Return the source number (n,) of each detection; sources are numbered by their brightest detection."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    n = len(vectors)
    if n == 0:
        return np.zeros(0, np.int64)
    pairs = cKDTree(vectors).query_pairs(2.0 * np.sin(radius / 2.0), output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    _, frame = np.unique(np.char.add(np.char.add(found["obsid"], "/"), found["chip"].astype(str)), return_inverse=True)
    label = _split_repeated(label.astype(np.int64), frame, vectors)
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[label]


def _split_repeated(label, frame, vectors):
    """Split the groups in which one frame occurs twice; detections are in order of brightness."""
    order = np.lexsort((frame, label))
    repeated = (np.diff(label[order]) == 0) & (np.diff(frame[order]) == 0)
    fresh = label.max() + 1
    by_label = np.argsort(label, kind="stable")
    bounds = np.searchsorted(label[by_label], np.arange(fresh + 1))
    for group in np.unique(label[order][1:][repeated]):
        rest = by_label[bounds[group] : bounds[group + 1]]
        while len(rest):
            # The brightest takes the nearest detection of every other frame.
            distance = np.linalg.norm(vectors[rest] - vectors[rest[0]], axis=1)
            near = np.lexsort((distance, frame[rest]))
            near = near[np.r_[True, np.diff(frame[rest][near]) != 0]]
            near = near[(frame[rest[near]] != frame[rest[0]]) | (near == 0)]
            # ... unless that one lies closer to another bright detection of this frame.
            rivals = vectors[rest[frame[rest] == frame[rest[0]]]]
            closest = np.linalg.norm(vectors[rest[near], None] - rivals, axis=2).min(axis=1)
            mine = near[distance[near] <= closest]
            label[rest[mine]] = fresh
            fresh += 1
            rest = np.delete(rest, mine)
    return label


def _photometry(found, count):
    source, band = found["source"], found["filter"]
    to_flux = 10.0 ** (0.4 * (AB_MICROJANSKY - found["zeropoint"]))  # microjansky per electron
    columns = {}
    for name in BANDS:
        rows = np.flatnonzero(band == name)
        columns[f"n_{name}"] = np.bincount(source[rows], minlength=count).astype(np.int32)
        for prefix, kind in (("", "psf"), ("kron_", "kron")):
            flux, error = (found[f"flux_{kind}{end}"][rows] * to_flux[rows] for end in ("", "_err"))
            mean, sigma = _weighted_mean(source[rows], flux, error, count)
            positive = mean > 0
            safe = np.where(positive, mean, 1.0)
            columns |= {f"{prefix}flux_{name}": mean, f"{prefix}flux_err_{name}": sigma}
            columns[f"{prefix}mag_{name}"] = np.where(positive, AB_MICROJANSKY - 2.5 * np.log10(safe), np.nan)
            columns[f"{prefix}mag_err_{name}"] = np.where(positive, 2.5 / np.log(10.0) * sigma / safe, np.nan)
    votes = np.maximum(found["snr"].astype(float), 1.0)
    flags = np.zeros(count, np.int32)
    np.bitwise_or.at(flags, source, found["flags"].astype(np.int32))
    star = np.bincount(source, votes * found["star"], count) / np.bincount(source, votes, count)
    total = np.bincount(source, minlength=count).astype(np.int32)
    return columns | {"n_detections": total, "star": star, "flags": flags}


def _weighted_mean(source, flux, error, count):
    """Inverse-variance mean and its error per source; NaN where nothing is usable."""
    good = np.isfinite(flux) & (error > 0)
    weight = 1.0 / error[good] ** 2
    total = np.bincount(source[good], weight, count)
    some = total > 0
    mean = np.bincount(source[good], weight * flux[good], count) / np.where(some, total, 1.0)
    return np.where(some, mean, np.nan), np.where(some, np.where(some, total, 1.0) ** -0.5, np.nan)


def write_merged(path, sources, detections, metadata):
    """Write one brick's parquet file in HATS form: the sources, each with the lists of its detections.

    List columns obsid, chip, filter and number lead to the rows of the measured tables. `metadata`: JSON-like,
    joined by `sources.meta`.
    """
    import pyarrow as pa

    offsets = pa.array(np.searchsorted(detections["source"], np.arange(len(sources) + 1)), pa.int32())
    columns = {name: pa.array(sources[name]) for name in sources.names}
    kinds = {"obsid": pa.string(), "chip": pa.int16(), "filter": pa.string(), "number": pa.int32()}
    for name, kind in kinds.items():
        columns[f"detection_{name}"] = pa.ListArray.from_arrays(offsets, pa.array(detections[name], kind))
    write_parquet(path, pa.table(columns), sources.meta | metadata)
