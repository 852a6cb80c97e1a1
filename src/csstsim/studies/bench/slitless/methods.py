"""csstsim's methods to render a spectrum, each as an imaging.methods.Method; peers.py has the paper's."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from csstsim.base.counter import object_keys
from csstsim.base.types import FloatArray, IntArray
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.slitless import reference_dispersed
from csstsim.render.slitless.dispersed_photons import shoot_spectra
from csstsim.render.slitless.draw_dispersed import draw_dispersed
from csstsim.render.slitless.slabs import draw_spectra
from csstsim.render.slitless.traces import Traces
from csstsim.studies.bench.imaging.methods import Method, drawing_of, expected_on
from csstsim.studies.bench.setting import disperser_of
from csstsim.studies.bench.slitless import peers
from csstsim.studies.bench.slitless.cases import means

if TYPE_CHECKING:
    from csstsim.catalog.light.object_spectra import Spectra
    from csstsim.catalog.table import ObjectTable
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.setting import Setting
    from csstsim.studies.bench.slitless.cases import SpectrumCase
    from csstsim.studies.bench.sweep import Draw

PER_PX = (1, 2, 4, 8)
WIDE = 1e-4  # fraction of a galaxy's flux that the standard may lose


def standard(setting: Setting, case: SpectrumCase) -> FloatArray:
    """Return the image that all are compared with: the reference renderer's, its stamps as high as the window."""
    wide = case.row.with_columns(reach=np.array([(case.window.ny - 1) // 2], np.int32), lost=np.array([WIDE]))
    return _drawn_by_reference(setting, case, wide)


def _drawn_by_reference(setting: Setting, case: SpectrumCase, rows: ObjectTable) -> FloatArray:
    canvas = Canvas(np.zeros(case.window.shape, np.float32), case.window)
    drawing = Drawing(setting.wcs, setting.psf, setting.exptime)
    reference_dispersed.draw_objects(canvas, rows, _spectra(setting, case), disperser_of(setting), drawing)
    return expected_on(canvas).astype(float)


def _spectra(setting: Setting, case: SpectrumCase) -> Spectra:
    """Return the case's spectrum in the form of catalog.light.object_spectra.Spectra."""

    def spectra(rows: IntArray, edges: FloatArray) -> FloatArray:
        return np.repeat(means(case.density, edges)[None] / setting.exptime, len(rows), axis=0)

    return cast("Spectra", spectra)  # all that is used of it is a call


def _reference(setting: Setting, case: SpectrumCase) -> Draw:
    """Return the reference's draw, on stamps no higher than the window: those of a bulge's reach take minutes."""
    reach = np.minimum(case.row["reach"], (case.window.ny - 1) // 2).astype(np.int32)
    rows = case.row.with_columns(reach=reach)
    return lambda copies: _drawn_by_reference(setting, case, rows.take(np.zeros(copies, int)))


def _many(setting: Setting, case: SpectrumCase, copies: int) -> tuple[Scene, Traces]:
    """Return (Scene, Traces) of `copies` of the object, without light beyond the PSF's box."""
    visits = np.repeat(case.visits, copies, axis=0)
    visits[:, 0] = np.arange(copies)
    scene = case.scene.take(np.zeros(copies, int)).sized(np.repeat(case.row["reach"], copies))
    return scene, Traces(np.repeat(case.binned_density[None], copies, axis=0), visits, disperser_of(setting))


def _photons(setting: Setting, case: SpectrumCase) -> Draw:
    base = np.uint64(case.id + 1)

    def draw(copies: int) -> IntArray:
        canvas = Canvas(None, case.window)
        keys = object_keys(base, np.arange(copies))
        counted = canvas.count()
        shoot_spectra(canvas, *_many(setting, case, copies), keys, setting.table)
        return counted

    return draw


def slabs(per_px: int) -> Callable[[Setting, SpectrumCase], Draw]:
    """Return the prepare of slabs, `per_px` of them per pixel."""

    def prepare(setting: Setting, case: SpectrumCase) -> Draw:
        def draw(copies: int) -> FloatArray:
            canvas = Canvas(np.zeros(case.window.shape), case.window)
            draw_spectra(canvas, *_many(setting, case, copies), setting.mixer, per_px=per_px)
            return expected_on(canvas)

        return draw

    return prepare


def _preset(fidelity: str) -> Callable[[Setting, SpectrumCase], Draw]:
    def prepare(setting: Setting, case: SpectrumCase) -> Draw:
        def draw(copies: int) -> FloatArray | IntArray:
            canvas = Canvas(np.zeros(case.window.shape, np.float32), case.window)
            rows = case.row.take(np.zeros(copies, int))
            drawing = drawing_of(setting, case, fidelity)
            draw_dispersed(canvas, rows, _spectra(setting, case), disperser_of(setting), drawing)
            return expected_on(canvas).astype(float) if canvas.counted is None else canvas.counted

        return draw

    return prepare


METHODS: tuple[Method[SpectrumCase], ...] = (
    Method("reference", _reference),
    Method("photons", _photons),
    *(Method(f"slabs {per_px}", slabs(per_px)) for per_px in PER_PX),
    *(Method(name, _preset(name), preset=True) for name in ("standard", "noise_free")),
    Method("as the paper", peers.paper, peer=True),
)
