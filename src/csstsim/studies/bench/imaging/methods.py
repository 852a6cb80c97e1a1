"""csstsim's methods to render an object, each as a Method; peers.py has those of other codes.

A Method's `prepare(setting, case)` does the work that is common to many objects (look up a PSF, make a table) and
returns `draw(copies)`, which is timed. It renders the object that many times and returns the sum (ny, nx) [electron].
To add a method, write its prepare and list it in METHODS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic

import numpy as np

from csstsim.base.counter import object_keys
from csstsim.base.types import FloatArray, IntArray
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging import draw as engine
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.reference import draw_objects
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.parts.object_parts import part_keys
from csstsim.studies.bench.imaging import peers, ufig
from csstsim.studies.bench.sweep import CaseT

if TYPE_CHECKING:
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.imaging.cases import Case
    from csstsim.studies.bench.setting import Setting
    from csstsim.studies.bench.sweep import Draw


@dataclass(frozen=True)
class Method(Generic[CaseT]):
    """A method to render objects.

    random: electrons are drawn at random, as they always are if the image has integers; electrons_max: drawn at once;
    for brighter objects the cost is taken as proportional to flux; peer: another code, or the paper's method; preset: a
    fidelity preset, which chooses among the other methods.
    """

    name: str
    prepare: Callable[[Setting, CaseT], Draw]
    random: bool = False
    electrons_max: float = np.inf
    peer: bool = False
    preset: bool = False


def standard(setting: Setting, case: Case) -> FloatArray:
    """Return the image that all methods are compared with: the reference renderer's, its stamp the whole window."""
    wide = case.row.with_columns(reach=np.array([case.half], np.int32), lost=np.array([1e-4]))
    return _reference(setting, replace(case, row=wide))(1)


def _reference(setting: Setting, case: Case) -> Draw:
    def draw(copies: int) -> FloatArray:
        canvas = Canvas(np.zeros(case.window.shape, np.float32), case.window)
        rows = case.row.take(np.zeros(copies, int))
        draw_objects(canvas, rows, Drawing(setting.wcs, setting.psf, setting.exptime))
        return expected_on(canvas).astype(float)

    return draw


def expected_on(canvas: Canvas) -> FloatArray:
    """Return the plane of expected electrons of a Canvas that has one."""
    assert canvas.expected is not None
    return canvas.expected


def copies_of(scene: Scene, copies: int) -> Scene:
    """Return the Scene with copies of a Scene's one object."""
    first = np.zeros(copies, int)
    if scene.parent is None:
        return scene.take(first)
    others = len(scene) - 1
    scenes = scene.take(np.concatenate([first, np.repeat(np.arange(1, others + 1), copies)]))
    return replace(scenes, parent=np.tile(np.arange(copies), others + 1))


def _photons(setting: Setting, case: Case) -> Draw:
    base = np.uint64(case.id + 1)

    def draw(copies: int) -> IntArray:
        canvas = Canvas(None, case.window)
        scene = copies_of(case.scene, copies)
        counted = canvas.count()
        shoot_scene(canvas, scene, part_keys(object_keys(base, np.arange(copies)), scene), setting.table)
        return counted

    return draw


def _stamps(setting: Setting, case: Case) -> Draw:
    def draw(copies: int) -> FloatArray:
        canvas = Canvas(np.zeros(case.window.shape), case.window)
        draw_scene(canvas, copies_of(case.scene, copies).sized(case.row["reach"][0]), setting.mixer)
        return expected_on(canvas)

    return draw


def drawing_of(setting: Setting, case: Case, fidelity: str) -> Drawing:
    """Return the render.drawing.Drawing of a preset, without scattered light beyond the PSF's box."""
    return Drawing(
        setting.wcs,
        setting.mixer.psf,
        setting.exptime,
        Scattered(),
        fidelity,
        setting.variance,
        np.uint64(case.id + 1),
        setting.table,
        cached_mixer=setting.mixer,
    )


def _preset(fidelity: str) -> Callable[[Setting, Case], Draw]:
    def prepare(setting: Setting, case: Case) -> Draw:
        def draw(copies: int) -> FloatArray | IntArray:
            canvas = Canvas(np.zeros(case.window.shape, np.float32), case.window)
            engine.draw_objects(canvas, case.row.take(np.zeros(copies, int)), drawing_of(setting, case, fidelity))
            return expected_on(canvas).astype(float) if canvas.counted is None else canvas.counted

        return draw

    return prepare


METHODS: tuple[Method[Case], ...] = (
    Method("reference", _reference),
    Method("photons", _photons),
    Method("stamps", _stamps),
    *(Method(name, _preset(name), preset=True) for name in ("preview", "standard", "noise_free")),
    Method("GalSim as the paper", peers.paper, peer=True),
    Method("GalSim FFT", peers.fft, peer=True),
    Method("GalSim photons", peers.photons, random=True, electrons_max=1e6, peer=True),
    *([Method("UFig", ufig.prepare, random=True, peer=True)] if ufig.INSTALLED else []),
)
