"""Drawing a chip's objects: the policy's choice carried out, and what came of each object as truth.

Two planes (design): photons go to `counted`, whole electrons that are Poisson already; everything else to the image of
expected electrons, which becomes Poisson once, in `poisson_and_dark`.
"""

import time
from dataclasses import replace

import numpy as np

from csstsim.base.counter import object_keys
from csstsim.catalog.flags import BAD_VALUE, OFF_CHIP, OUTSIDE_PSF_HULL, SKIPPED_FAINT, STRONG_LENSING, TRUNCATED_STAMP
from csstsim.render import policy
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.imaging.unresolved import add_unresolved
from csstsim.render.psf_mixture import Mixer
from csstsim.render.scene import make_scene
from csstsim.render.settings import load_numbers

_UNDRAWN = BAD_VALUE | STRONG_LENSING


def draw_objects(
    image, window, objects, wcs, psf, exptime, *, tables, beyond, response, maximum, variance, key, fidelity
):
    """Draw a chip's objects; return (table with what was drawn, counted electrons or None).

    image: float32 (window.ny, window.nx), expected electrons, changed in place; counted: int32 of that shape. objects:
    ObjectTable of select_objects. psf: PsfSet, or the Mixer of one (kept between calls, it saves some 10 ms); tables:
    psf_table.PsfTable of it. beyond: optics.scatter.outside_box.Beyond.
    response: (ny, nx) float32 share of light that is counted, nowhere above `maximum`, or None: all. variance: of a
    pixel without objects [e-^2]. key: uint64 of the exposure's random numbers; fidelity: of config/render.yaml.

    Added columns: electrons (nominal), drawn (put on the window: whole electrons for photons, the sum of expected ones
    otherwise), fraction (drawn over nominal), method (render.policy), snr (against its own light and the pixels it
    covers), error (predicted, in units of its own noise), stamp (side, pixel, its wing's included), x0 x1 y0 y1
    (bounding box on the chip, half-open), ms (CPU: measured for stamps, of which the first sets up the rest; for
    photons the time of all, shared by predicted cost).
    """
    mixer = psf if isinstance(psf, Mixer) else Mixer(psf)
    psf, count = mixer.psf, len(objects)
    electrons = np.sum([objects[f"flux{i}"] for i in range(4)], axis=0) * exptime
    flags = objects["flags"].copy()
    rows = np.flatnonzero((flags & _UNDRAWN == 0) & (electrons > 0))
    part = objects.take(rows)
    scene = make_scene(part, wcs, psf, exptime)
    flags[rows[scene.outside]] |= OUTSIDE_PSF_HULL
    flags[rows[(beyond.wing is None) & (part["wing"] > 0)]] |= TRUNCATED_STAMP
    wing = part["wing"] if beyond.wing is not None else np.zeros(len(rows))
    choice = policy.choose(
        scene, part["reach"], wing, variance, fidelity, convex=psf.convex, per_pixel=psf.oversampling, maximum=maximum,
        ghosts=beyond.ghosts is not None and beyond.ghosts.visible(scene.electrons.sum(axis=1)),
    )  # fmt: skip
    keys = object_keys_of(key, scene.ids)
    drawn, ms, error, snr = np.zeros(count), *(np.zeros(count, np.float32) for _ in range(3))
    snr[rows] = choice.snr
    box, stamp = np.zeros((count, 4), np.int32), np.zeros(count, np.int32)
    method = np.full(count, policy.METHODS[policy.NONE], dtype="U10")
    full = np.ones(window.shape, np.float32) if response is None else response
    counted = None
    for kind in (policy.UNRESOLVED, policy.STAMP, policy.PHOTONS):
        mine = np.flatnonzero(choice.method == kind)
        if not mine.size:
            continue
        start, some, at = time.process_time(), scene.take(mine), rows[mine]
        if kind == policy.UNRESOLVED:
            drawn[at], box[at] = add_unresolved(image, window, some if beyond.wing else _boxed(some, psf), full)
            flags[at] |= SKIPPED_FAINT
        elif kind == policy.STAMP:
            result = draw_scene(image, window, some, part["reach"][mine], wing[mine], mixer, beyond, response, wcs.chip)
            drawn[at], box[at], ms[at] = result.drawn, result.box, result.ms
            flags[at] |= result.flags
            stamp[at] = 2 * np.maximum(part["reach"][mine], np.ceil(wing[mine])) + 1
        else:
            counted = np.zeros(window.shape, np.int32)
            drawn[at], _, box[at] = shoot_scene(
                counted, window, some, keys[mine], tables, response, maximum, beyond.wing
            )
        if kind != policy.STAMP:
            work, _ = policy.costs(some, 0, 0, some.electrons.sum(axis=1), load_numbers().cost)
            ms[at] = 1000 * (time.process_time() - start) * work / work.sum()
        method[at], error[at] = policy.METHODS[kind], choice.error[mine]
    off = rows[(drawn[rows] == 0) & _misses(window, part)]
    flags[off] |= OFF_CHIP
    method[off] = policy.METHODS[policy.NONE]
    fraction = np.divide(drawn, electrons, out=np.zeros(count), where=electrons > 0)
    table = objects.with_columns(
        flags=flags, electrons=electrons, drawn=drawn, fraction=fraction, method=method, snr=snr, error=error,
        stamp=stamp, x0=box[:, 0], x1=box[:, 1], y0=box[:, 2], y1=box[:, 3], ms=ms,
    )  # fmt: skip
    return table, counted


def _misses(window, part):
    """Whether the stamp of each object, its wing's included, misses the window; no electron there may be chance."""
    reach = np.maximum(part["reach"], part["wing"]) + 0.5
    spans = (part["x"], window.x0, window.x1), (part["y"], window.y0, window.y1)
    return np.logical_or(*((at + reach < low - 0.5) | (at - reach > high - 0.5) for at, low, high in spans))


def _boxed(scene, psf):
    """Return a Scene with the light that falls within the PSF's box."""
    inside = np.einsum("nk,nkb->nb", scene.weight, np.where(scene.weight[..., None] > 0, psf.flux[scene.node], 0.0))
    return replace(scene, electrons=scene.electrons * inside)


def object_keys_of(base, ids):
    """Return a key for each object: of its id, and, where a catalogue gives an id twice, of which of them it is."""
    order = np.argsort(ids, kind="stable")
    first = np.r_[True, np.diff(ids[order]) != 0]
    place = np.arange(len(ids))
    again = np.empty(len(ids), np.int64)
    again[order] = place - np.maximum.accumulate(np.where(first, place, 0))
    keys = object_keys(base, ids)
    for i in np.flatnonzero(again):
        keys[i] = object_keys(~keys[i], again[i : i + 1])[0]  # the words of the key itself are the first one's
    return keys
