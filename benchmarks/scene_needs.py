"""What each effect costs and what it changes, in one window of an r and of a GV chip: docs/model_no_more.md.

    python benchmarks/scene_needs.py [--chips 9 29] [--size 1200]        # six CPU-minutes

CPU seconds: a complete frame less one without the effect, the least of --repeats. Changes: two frames that differ in
the effect alone, electrons, with overscan and gain taken out. They have no photon noise (`fidelity: noise_free`), no
cosmic rays, the same read noise (so that rounding is random), and objects to LIMIT; an effect that is noise is added
to one of them. Ways to draw are compared with photon noise and all objects. Shares are of the default. Writes also
docs/scene_needs.csv.
"""

import argparse
import csv
import tempfile
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from evidence.record import Record

import numpy as np
from scene_measures import changes, measurer
from scene_table import FIELDS, KINDS, by_chip, draw, table

import csstsim
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera

RA, DEC, OBSID = 300.0, -60.0, "10100000001"
LIMIT = {"imaging": 25.0, "slitless": 22.0}  # mag, of the frames without noise: 3 ms an object
NOISE = ("poisson_and_dark", "cosmic_rays")
# At the size of seconds: effects, and changes that keep truth bricks and PSF sets cheap
TOY_EFFECTS = "flat field", "shutter", "photon noise, dark", "charge transfer, irradiated", "objects to 24 mag"
TOY_SIZE, TOY_CATALOG, TOY_PSF = 150, {"structure": "none", "lensing": {"field": "none"}}, {"grid": 2}
TOY_PLACE = 299.907, -60.245  # deg: the middle of a truth brick


def layer(name, **values):
    """Return the change of a Simulation that gives a layer these parameters, or leaves it out."""
    return {"layers": {name: values or None}}


FLAT = {"layers": {name: {"flat_fielding": False} for name in ("scie_obs", "sky_background")}}
SHUTTER = {"layers": {name: {"shutter_effect": False} for name in ("scie_obs", "sky_background")}}
IMAGING, BOTH = "imaging", "imaging slitless"
# kind: "off": in the default, left out; "on": not in the default, added; "noise": in the default, random
EFFECTS = (  # (name, kind, where, change, line of YAML)
    ("objects' wings", "off", BOTH, layer("scie_obs", wings=False), "scie_obs: {wings: false}"),
    ("ghosts", "off", IMAGING, layer("scie_obs", ghosts=False), "scie_obs: {ghosts: false}"),
    ("field distortion", "off", BOTH, layer("scie_obs", field_dist=False), "scie_obs: {field_dist: false}"),
    ("flat field", "off", BOTH, FLAT, "flat_fielding: false, in scie_obs and sky_background"),
    ("shutter", "off", BOTH, SHUTTER, "shutter_effect: false, in scie_obs and sky_background"),
    ("sky", "off", BOTH, layer("sky_background"), "remove sky_background"),
    ("sky model", "on", BOTH, layer("sky_background", enable_straylight_model=True),
     "sky_background: {enable_straylight_model: true}"),
    ("pixels' response", "off", BOTH, layer("PRNU_effect"), "remove PRNU_effect"),
    ("cosmic rays", "noise", BOTH, layer("cosmic_rays"), "remove cosmic_rays"),
    ("photon noise, dark", "noise", IMAGING, {"layers": dict.fromkeys(NOISE)},
     "fidelity: noise_free, remove poisson_and_dark and cosmic_rays"),
    ("brighter-fatter", "off", BOTH, layer("brighter_fatter"), "remove brighter_fatter"),
    ("defects", "off", BOTH, layer("detector_defects"), "remove detector_defects"),
    ("blooming", "off", BOTH, layer("blooming"), "remove blooming"),
    ("charge transfer, new device", "off", BOTH, layer("CTE_effect"), "remove CTE_effect"),
    ("charge transfer, irradiated", "on", BOTH, layer("CTE_effect", density_scale=1.0),
     "CTE_effect: {density_scale: 1}"),
    ("nonlinearity", "off", BOTH, layer("nonlinearity"), "remove nonlinearity"),
    ("read noise", "off", BOTH, layer("readout_noise"), "remove readout_noise"),
    ("one gain for all channels", "on", BOTH, layer("gain", gain_16channel=False), "gain: {gain_16channel: false}"),
    ("PSF grid 6", "on", BOTH, {"psf": {"grid": 6}}, "psf: {grid: 6}"),
    ("PSF bicubic", "on", IMAGING, {"psf": {"interpolation": "bicubic"}}, "psf: {interpolation: bicubic}"),
    ("PSF idw", "on", BOTH, {"psf": {"interpolation": "idw"}}, "psf: {interpolation: idw}"),
    ("PSF 2 cells a pixel", "on", IMAGING, {"psf": {"oversampling": 2}}, "psf: {oversampling: 2}"),
    ("objects to 26 mag", "draw", BOTH, {"catalog": {"mag_limit": 26.0}}, "catalog: {mag_limit: 26}"),
    ("objects to 24 mag", "draw", BOTH, {"catalog": {"mag_limit": 24.0}}, "catalog: {mag_limit: 24}"),
    ("lensing", "off", BOTH, {"catalog": {"lensing": {"field": "none"}}}, "catalog: {lensing: {field: none}}"),
    ("planets' deflection", "on", BOTH, {"astrometry": {"planets": True}}, "astrometry: {planets: true}"),
    ("fidelity: preview", "draw", BOTH, {"fidelity": "preview"}, "fidelity: preview"),
    ("fidelity: noise_free", "draw", IMAGING, {"fidelity": "noise_free"}, "fidelity: noise_free"),
)  # fmt: skip


def _kind(chip):
    return load_camera(SHIPPED / "instrument").chips[chip].kind


def timed(sim, chip):
    """Return (frame, CPU s)."""
    start = time.process_time()
    frame = sim.chip(OBSID, chip)
    return frame, time.process_time() - start


def without_noise(sim, chip, but=()):
    """Return the Simulation with expected light (imaging), objects to LIMIT and no layers of NOISE, except those `but`.

    Behind gratings expected light of large galaxies takes minutes: these frames are drawn as by default, with photons.
    """
    kind = _kind(chip)
    but = but if kind == "imaging" else {*but, "poisson_and_dark"}
    catalog = sim.config.catalog.model_dump() | {"mag_limit": LIMIT[kind]}
    fidelity = "noise_free" if kind == "imaging" else "standard"
    return sim.replace(fidelity=fidelity, catalog=catalog, layers={name: None for name in NOISE if name not in but})


def frames(full, quiet, effect, chip):
    """Return two Frames that differ in an effect: without and with it. quiet: the default without noise."""
    _, kind, _, change, _ = effect
    if kind == "draw":  # photon noise belongs to it
        silent = full.replace(layers={"cosmic_rays": None})
        return [sim.chip(OBSID, chip) for sim in (silent, silent.replace(**change))]
    if kind == "noise":  # cosmic rays must be followed by photon noise
        noisy = without_noise(full, chip, but=NOISE[:1]).chip(OBSID, chip)
        if "poisson_and_dark" in change["layers"]:
            return quiet, noisy
        return noisy, without_noise(full, chip, but=NOISE).chip(OBSID, chip)
    other = without_noise(full.replace(**change), chip).chip(OBSID, chip)
    return (other, quiet) if kind == "off" else (quiet, other)


def row(full, quiet, effect, chip, measure):
    """Return what an effect changes, as a dict of scene_table.FIELDS without the cost."""
    before, after = frames(full, quiet, effect, chip)
    default, other = (after, before) if effect[1] == "off" else (before, after)
    difference = after.electrons.astype(float) - before.electrons
    found = {
        "effect": effect[0], "kind": effect[1], "yaml": effect[4], "rms": difference.std(),
        "largest": np.abs(difference).max(), "light": 100 * difference.sum() / default.electrons.sum(dtype=float),
    }  # fmt: skip
    for name, (_, of) in measure.items():
        light, size, e = changes(of(default), of(other))
        found |= {f"{name} light": light, f"{name} size": size, f"{name} e": e}
    return found


def costs(full, effects, chip, repeats):
    """Return ({effect: CPU s that it costs}, CPU s of the complete frame, its scatter): the least of the repeats."""
    sims = {None: full} | {effect[0]: full.replace(**effect[3]) for effect in effects}
    spent = {name: [] for name in sims}
    for _ in range(repeats):  # in turn, so that a busy minute meets all of them
        for name, sim in sims.items():
            spent[name].append(timed(sim, chip)[1])
    least = {name: min(values) for name, values in spent.items()}
    sign = {effect[0]: 1 if effect[1] in ("off", "noise") else -1 for effect in effects}
    print(f"chip {chip}: complete frame {sorted(np.round(spent[None], 2))} CPU-s")
    return {name: sign[name] * (least[None] - least[name]) for name in sign}, least[None]


def scene(chip, size, repeats, cache, toy=False):
    """Return the rows of one chip's window, dicts of scene_table.FIELDS."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a window may cut an order
        full = csstsim.Simulation(cache=cache).aim(*(TOY_PLACE if toy else (RA, DEC)), chip, size=size)
    catalog, psf = (TOY_CATALOG, TOY_PSF) if toy else ({}, {"grid": 10})
    full = full.replace(catalog={"kind": "embedded"} | catalog, psf=psf, fidelity="standard")
    frame = without_noise(full, chip).chip(OBSID, chip)
    effects = [effect for effect in EFFECTS if _kind(chip) in effect[2]]
    if toy:
        effects = [effect for effect in effects if effect[0] in TOY_EFFECTS]
        effects = [(*some, {k: catalog | v if k == "catalog" else v for k, v in change.items()}, line)
                   for *some, change, line in effects]  # fmt: skip
    measure, rows = measurer(frame), []
    counts = {name: len(ids) for name, (ids, _) in measure.items()}
    print(f"chip {chip}, {len(frame.truth)} objects, measured: {counts}", flush=True)
    for effect in effects:
        rows.append(row(full, frame, effect, chip, measure))
        print(", ".join(f"{v:.3g}" if isinstance(v, float) else v for v in rows[-1].values()), flush=True)
    can_be_out = [effect for effect in effects if "poisson_and_dark" not in effect[3].get("layers", {})]
    spent, whole = costs(full, can_be_out, chip, repeats)  # photons cannot be drawn without their noise
    name = str(frame.truth["filter"][0])
    about = {"chip": chip, "filter": name, "size": size, "whole": whole, **counts}
    rows = [about | {"cost": spent.get(each["effect"], np.nan)} | each for each in rows]
    return rows


def figures(record: Record, rows: list[dict]) -> None:
    """Record the numbers of one chip that the page's text has."""
    chip, side = rows[0]["chip"], rows[0]["size"]
    record.value(f"whole_{chip}", rows[0]["whole"], f"a window of {side} x {side} px of chip {chip}", unit="CPU-s")
    found = {row["effect"]: row for row in rows}
    for kind in KINDS:
        if kind not in rows[0]:
            continue
        key, objects = kind.replace(" ", "_"), f"{kind} of chip {chip}"
        record.value(f"{key}_{chip}", rows[0][kind], f"{objects} that are measured")
        for name, effect in (
            ("traps", "charge transfer, irradiated"), ("flat", "flat field"), ("shutter", "shutter"),
            ("mag_24", "objects to 24 mag"),
        ):  # fmt: skip
            light = found[effect][f"{kind} light"]
            record.value(f"{key}_{name}_{chip}", light, f"median change of light of {objects}: {effect}", unit="%")


def main(record: Record) -> None:
    """Measure the windows; record, draw and store what was found."""
    options, toy = record.options, record.toy
    cache = options.cache or (record.results / "cache" if toy else None)
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(1 if toy else len(options.chips)) as pool:
        size, repeats = (TOY_SIZE, 1) if toy else (options.size, options.repeats)
        run = partial(scene, size=size, repeats=repeats, cache=cache or folder, toy=toy)
        found = [row for rows in pool.map(run, options.chips) for row in rows]
    path = record.figure("scene_needs.png")
    draw(found, path)
    with open(path.parents[1] / "scene_needs.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, restval="")
        writer.writeheader()
        writer.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in each.items()} for each in found)
    for chip, rows in by_chip(found).items():
        figures(record, rows)
        record.table(f"chip_{chip}", *table(rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chips", type=int, nargs="+", default=[9, 29])
    parser.add_argument("--size", type=int, default=1200, help="side of the window [px]")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--cache", help="folder of truth bricks and PSF sets, if they are to be kept")
    with Record(parser) as record:
        main(record)
