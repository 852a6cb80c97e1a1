"""csstsim's ways to draw an object, each as a Method; peers.py has those of other codes.

A Method's `prepare(setting, case)` does the work that many objects share (look up a PSF, make a table) and returns
`draw(copies)`, which is timed. It draws the object that many times and returns the sum [electron], (ny, nx). To add
a method, write its prepare and list it in METHODS.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from csstsim.base.counter import object_keys
from csstsim.bench.imaging import peers, ufig
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging import draw as engine
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.reference import draw_objects
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.parts.object_parts import part_keys


@dataclass(frozen=True)
class Method:
    """`random`: electrons are drawn at random, as they always are if the image has integers.

    `most`: electrons drawn at once; for brighter objects cost is taken as proportional to light. `peer`: another code,
    or the paper's method; `preset`: a fidelity preset, which chooses among the other methods.
    """

    name: str
    prepare: Callable
    random: bool = False
    most: float = np.inf
    peer: bool = False
    preset: bool = False


def standard(setting, case):
    """Return the image that all methods are compared with: the reference renderer's, its stamp the whole window."""
    wide = case.row.with_columns(reach=np.array([case.half], np.int32), lost=np.array([1e-4]))
    return _reference(setting, replace(case, row=wide))(1)


def _reference(setting, case):
    def draw(copies):
        canvas = Canvas(np.zeros(case.window.shape, np.float32), case.window)
        rows = case.row.take(np.zeros(copies, int))
        draw_objects(canvas, rows, Drawing(setting.wcs, setting.psf, setting.exptime))
        return canvas.expected.astype(float)

    return draw


def copies_of(scene, copies):
    """Return the Scene of many copies of a Scene's one object."""
    first = np.zeros(copies, int)
    if scene.parent is None:
        return scene.take(first)
    others = len(scene) - 1
    made = scene.take(np.concatenate([first, np.repeat(np.arange(1, others + 1), copies)]))
    return replace(made, parent=np.tile(np.arange(copies), others + 1))


def _photons(setting, case):
    base = np.uint64(case.row["id"][0] + 1)

    def draw(copies):
        canvas, scene = Canvas(None, case.window), copies_of(case.scene, copies)
        counted = canvas.count()
        shoot_scene(canvas, scene, part_keys(object_keys(base, np.arange(copies)), scene), setting.table)
        return counted

    return draw


def _stamps(setting, case):
    def draw(copies):
        canvas = Canvas(np.zeros(case.window.shape), case.window)
        draw_scene(canvas, copies_of(case.scene, copies).sized(case.row["reach"][0]), setting.mixer)
        return canvas.expected

    return draw


def drawing_of(setting, case, fidelity):
    """Return the render.drawing.Drawing of a preset, without light beyond the PSF's box."""
    return Drawing(
        setting.wcs, setting.mixer.psf, setting.exptime, Scattered(), fidelity, setting.variance,
        np.uint64(case.row["id"][0] + 1), setting.table, setting.mixer,
    )  # fmt: skip


def _preset(fidelity):
    def prepare(setting, case):
        def draw(copies):
            canvas = Canvas(np.zeros(case.window.shape, np.float32), case.window)
            engine.draw_objects(canvas, case.row.take(np.zeros(copies, int)), drawing_of(setting, case, fidelity))
            return canvas.expected.astype(float) if canvas.counted is None else canvas.counted

        return draw

    return prepare


METHODS = (
    Method("reference", _reference),
    Method("photons", _photons),
    Method("stamps", _stamps),
    *(Method(name, _preset(name), preset=True) for name in ("preview", "standard", "noise_free")),
    Method("GalSim as the paper", peers.paper, peer=True),
    Method("GalSim FFT", peers.fft, peer=True),
    Method("GalSim photons", peers.photons, random=True, most=1e6, peer=True),
    *([Method("UFig", ufig.prepare, random=True, peer=True)] if ufig.THERE else []),
)
