"""Every method on every case: what it costs and how wrong it is, one row each."""

import time

import numpy as np
from galsim import GalSimError

from csstsim.bench.measures import NAMES, WINDOW_PX, errors
from csstsim.bench.methods import brighter, standard
from csstsim.bench.truth import Truth
from csstsim.progress import progress

SLOW = 1.0  # CPU seconds of one object, beside which its set-up does not count
TOO_LONG = 5.0  # times the wanted CPU seconds, after which no more electrons are drawn


def sweep(setting, cases, methods, *, seconds, electrons):
    """Return a list of rows (dicts, see `row`).

    A cost is measured over at least `seconds` of CPU time, or one object if that takes longer; methods that draw random
    electrons draw each object until it has `electrons`.
    """
    truth, rows = Truth(setting), []
    for kind in (True, False):  # compiled and warm before anything is timed
        faintest = min((case for case in cases if case.star == kind), key=lambda case: case.electrons)
        for method in methods:
            measured(method, setting, brighter(faintest, 2000.0), 0.0, 0.0)
            measured(method, setting, faintest, 0.0, 0.0)
    for case in progress(cases, "objects"):
        direct, reference = truth(case), standard(setting, case) / case.electrons
        for method in methods:
            rows.append(row(method, setting, case, direct, reference, seconds, electrons))
    return rows


def row(method, setting, case, direct, reference, seconds, electrons):
    """Return {column: value}: the object, CPU seconds, errors against the standard and direct optics, chance."""
    size = half_light_px(case.scene)
    about = {
        "method": method.name, "object": int(case.row["id"][0]), "kind": "star" if case.star else "galaxy",
        "electrons": case.electrons, "half_light": float(case.row["size_disk"][0]),
        "bulge": float(case.row["bulge_frac"][0]), "e": float(np.hypot(case.row["e1"], case.row["e2"])[0]),
        "reach": int(case.row["reach"][0]), "at_node": case.at_node, "snr": significance(direct, case, setting),
    }  # fmt: skip
    try:
        image, cost, drawn = measured(method, setting, case, seconds, electrons)
    except GalSimError:  # its transform would not fit the memory
        image, cost, drawn = np.full_like(direct, np.nan), np.nan, 0
    judged = {}
    if drawn:
        box = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling
        scale = 1000 * setting.camera.telescope.pixel_scale
        how = {"box": box, "sigma": max(WINDOW_PX, size), "mas_per_px": scale}
        for name, wanted in (("standard", reference), ("direct", direct)):
            judged[name], chance = errors(image, wanted, setting.variance, case.electrons, drawn, **how)
        judged["chance"] = chance
    nothing = np.full(len(NAMES), np.nan)
    columns = {
        f"{name}_{which}": value
        for which in ("standard", "direct", "chance")
        for name, value in zip(NAMES, judged.get(which, nothing), strict=True)
    }
    return about | {"cpu_s": cost, "drawn": drawn} | columns


def measured(method, setting, case, seconds, electrons):
    """Return (image of an object of unit light, CPU seconds an object, electrons drawn; infinite if none is random)."""
    used = min(case.electrons, method.most)
    draw = method.prepare(setting, brighter(case, used))
    copies, (image, took) = 1, _timed(draw, 1)
    if took < SLOW:  # the first draw sets up what is kept
        image, took = _timed(draw, 1)
    random = method.random or image.dtype.kind == "i"
    while took < seconds:
        copies *= int(np.ceil(np.clip(1.2 * seconds / max(took, 1e-9), 2, 10)))
        image, took = _timed(draw, copies)
    enough = min(electrons / used, TOO_LONG * seconds / took * copies) if random else 0
    if enough > copies:
        copies = int(np.ceil(enough))
        image, took = _timed(draw, copies)
    drawn = copies * used if random else np.inf
    return image / (copies * used), took / copies * case.electrons / used, drawn


def _timed(draw, copies):
    start = time.process_time()
    image = draw(copies)
    return image, time.process_time() - start


def significance(light, case, setting):
    """Return the S/N of an object under an ideal filter, its own noise in it."""
    light = case.electrons * np.maximum(light, 0)
    return float(np.sqrt((light**2 / (light + setting.variance)).sum()))


def half_light_px(scene):
    """Return the half-light radius of a Scene's one object, its larger component's, drawn out to a circle's [px]."""
    radius = np.where(scene.light[0] > 0, scene.sersic[0, :, 2], 0.0).max()
    return float(radius * np.sqrt(abs(np.linalg.det(scene.matrix[0]))))
