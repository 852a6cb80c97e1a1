"""Light, size and ellipticity of objects in a frame by simple apertures, for scene_needs.py: what an effect changes.

Moments are those of the pixels in an aperture at the true place, with a round Gaussian weight, above the mean of a
ring. Behind a grating the aperture is a strip along the first order, and the size is the one across it.
"""

import numpy as np
from scipy.spatial import cKDTree

from csstsim.catalog.table import GALAXY, STAR

RADIUS, RING, WEIGHT = 10.0, (14.0, 20.0), 3.0  # px: aperture, ring of the background, sigma of the weight
STRIP, SIDE = 6, (10, 18)  # px from the trace: half the strip, rows of its background
EDGE, LARGE = 26.0, 0.15  # px from the window's edge; least size [arcsec] of a galaxy
TRACE, WHOLE = 3000.0, 0.8  # least electrons of a first order, and their share on the window
ALONE, FAINTER = 20.0, 2.0  # px and mag: objects within and not fainter by this are neighbours
SNR, CHARGE = {STAR: 50.0, GALAXY: 20.0}, 5e4  # least S/N; most electrons of a star's brightest pixel
PEAK = 0.12  # about the share of a star's light in its brightest pixel
MOST = 40  # objects of a kind, the brightest


def places(frame):
    """Return the columns and rows [px of the frame's image] of all objects of its truth: (n, 2)."""
    truth, window = frame.truth, frame.window
    return np.column_stack([truth["xImage"] - 1.0 - window.x0, truth["yImage"] - 1.0 - window.y0])


def objects(frame, kind):
    """Return the ids of bright, unsaturated, isolated STARs or GALAXYs of a frame's truth that lie inside it."""
    truth, window, at, mag = frame.truth, frame.window, places(frame), np.array(frame.truth["mag"])
    inside = np.all((at > EDGE) & (at < np.array([window.nx, window.ny]) - EDGE), axis=1)
    good = inside & (truth["obj_type"] == kind) & (truth["snr"] > SNR[kind]) & (PEAK * truth["electrons"] < CHARGE)
    if kind == GALAXY:
        good &= truth["size"] > LARGE
    near = cKDTree(at).query_ball_point(at, ALONE)
    alone = [all(mag[k] > mag[i] + FAINTER for k in near[i] if k != i) for i in range(len(mag))]
    found = np.flatnonzero(good & alone)
    return np.array(truth["obj_ID"])[found[np.argsort(mag[found])][:MOST]]


def level(values, axis=None):
    """Return the mean without outliers; a median would be one of the few values that a digitised pixel has."""
    middle = np.median(values)
    near = np.abs(values - middle) <= 4 * 1.4826 * max(np.median(np.abs(values - middle)), 1.0)
    return np.average(values, axis=axis, weights=near + 1e-9)


def moments(frame, ids):
    """Return (n, 4): light [electron], size [px], e1, e2 of objects at their true places in this frame."""
    found, half, image = np.full((len(ids), 4), np.nan), int(RING[1]) + 1, frame.electrons
    row = {number: k for k, number in enumerate(frame.truth["obj_ID"])}
    at = places(frame)
    for k, number in enumerate(ids):
        x, y = at[row[number]] if number in row else (-1.0, -1.0)
        i, j = round(y), round(x)
        if min(i, j) < half or i + half >= image.shape[0] or j + half >= image.shape[1]:
            continue  # moved out of the window
        part = image[i - half : i + half + 1, j - half : j + half + 1].astype(float)
        v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
        u, v = u - (x - j), v - (y - i)
        r = np.hypot(u, v)
        part = part - level(part[(r > RING[0]) & (r < RING[1])])
        w = part * np.exp(-(r**2) / (2 * WEIGHT**2)) * (r < RADIUS)
        du, dv = u - (w * u).sum() / w.sum(), v - (w * v).sum() / w.sum()
        xx, yy, xy = ((w * a).sum() / w.sum() for a in (du**2, dv**2, du * dv))
        light = part[r < RADIUS].sum()
        found[k] = light, np.sqrt(max(xx + yy, 0.0) / 2), (xx - yy) / (xx + yy), 2 * xy / (xx + yy)
    return found


def first_orders(frame):
    """Return {id: (electrons, x0, x1, y)} [px of the image] of first orders that lie wholly on the window."""
    orders, window, found = frame.orders, frame.window, {}
    for row in orders[(orders["order"] == 1) & np.isfinite(orders["wave_min"])]:
        wave = np.array([row["wave_min"], row["wave_max"]])
        x0, x1 = np.sort(row["xImage"] - 1 + row["p"] + row["q"] * wave) - window.x0
        y = row["yImage"] - 1 + row["r"] + row["s"] * wave.mean() - window.y0
        whole = row["drawn"] > WHOLE * row["electrons"] and x0 > 2 and x1 < window.nx - 2
        if whole and SIDE[1] < y < window.ny - SIDE[1] - 1:
            found[row["id"]] = float(row["electrons"]), x0, x1, y
    return found


def bright_orders(frame):
    """Return the ids of the brightest first orders that are apart from brighter ones."""
    kept = {}
    for number, (electrons, x0, x1, y) in sorted(first_orders(frame).items(), key=lambda item: -item[1][0]):
        apart = all(abs(y - o[3]) > SIDE[1] or x0 > o[2] or x1 < o[1] for o in kept.values())
        if apart and electrons > TRACE:
            kept[number] = electrons, x0, x1, y
    return list(kept)[:MOST]


def strips(frame, ids):
    """Return (n, 4): light of first orders [electron], size across [px], NaN, NaN."""
    found, image, at = np.full((len(ids), 4), np.nan), frame.electrons, first_orders(frame)
    for k, number in enumerate(ids):
        if number not in at:
            continue  # moved to the edge of the window
        _, x0, x1, y = at[number]
        row = round(y)
        part = image[row - SIDE[1] : row + SIDE[1] + 1, int(x0) : int(x1) + 1].astype(float)
        v = np.arange(-SIDE[1], SIDE[1] + 1) - (y - row)
        part = (part - level(part[np.abs(v) > SIDE[0]], axis=0)).sum(axis=1)
        w = part * np.exp(-(v**2) / (2 * WEIGHT**2)) * (np.abs(v) <= STRIP)
        mean = (w * v).sum() / w.sum()
        found[k, :2] = part[np.abs(v) <= STRIP].sum(), np.sqrt(max((w * (v - mean) ** 2).sum() / w.sum(), 0.0))
    return found


def measurer(frame):
    """Return {kind: (ids, function of a frame that gives their (n, 4) moments)} for objects of a frame's truth."""
    if frame.orders is not None:
        chosen = {"first orders": (bright_orders(frame), strips)}
    else:
        chosen = {"stars": (objects(frame, STAR), moments), "galaxies": (objects(frame, GALAXY), moments)}
    return {kind: (ids, lambda other, ids=ids, of=of: of(other, ids)) for kind, (ids, of) in chosen.items()}


def changes(default, other):
    """Return the medians over objects of what differs: (light [%], size [%], ellipticity); absolute values, or NaN."""
    light, size = (100 * np.abs(other[:, k] / default[:, k] - 1) for k in (0, 1))
    e = np.hypot(*(other - default)[:, 2:].T)
    seen = (values[np.isfinite(values)] for values in (light, size, e))
    return tuple(float(np.median(values)) if values.size else np.nan for values in seen)
