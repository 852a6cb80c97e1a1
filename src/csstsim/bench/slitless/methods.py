"""The ways to draw a spectrum that csstsim has, each as an imaging.methods.Method; peers.py has the others'."""

import numpy as np

from csstsim.base.counter import object_keys
from csstsim.bench.imaging.methods import Method
from csstsim.bench.slitless import peers
from csstsim.bench.slitless.cases import means
from csstsim.optics.scatter.outside_box import Beyond
from csstsim.render.slitless import reference_dispersed
from csstsim.render.slitless.dispersed_photons import shoot_spectra
from csstsim.render.slitless.draw_dispersed import draw_dispersed
from csstsim.render.slitless.slabs import draw_spectra

PER_PX = (1, 2, 4, 8)
WIDE = 1e-4  # of a galaxy's light that the standard may lose


def standard(setting, case):
    """Return the image everything is compared with: the reference renderer, its stamps as high as the window."""
    wide = case.row.with_columns(reach=np.array([(case.window.ny - 1) // 2], np.int32), lost=np.array([WIDE]))
    return _drawn_by_reference(setting, case, wide)


def _drawn_by_reference(setting, case, rows):
    image = np.zeros(case.window.shape, np.float32)
    reference_dispersed.draw_objects(
        image, case.window, rows, _spectra(setting, case), setting.disperser, setting.wcs, setting.psf, setting.exptime
    )
    return image.astype(float)


def _spectra(setting, case):
    """Return the case's spectrum as catalog.light.object_spectra.Spectra gives those of a table."""
    return lambda rows, edges: np.repeat(means(case.density, edges)[None] / setting.exptime, len(rows), axis=0)


def _reference(setting, case):
    """The reference on stamps no higher than the window: on those of a bulge's own reach it takes minutes."""
    reach = np.minimum(case.row["reach"], (case.window.ny - 1) // 2).astype(np.int32)
    rows = case.row.with_columns(reach=reach)
    return lambda copies: _drawn_by_reference(setting, case, rows.take(np.zeros(copies, int)))


def _many(case, copies):
    """Return (Scene, light, visits) of that many of the object."""
    visits = np.repeat(case.visits, copies, axis=0)
    visits[:, 0] = np.arange(copies)
    return case.scene.take(np.zeros(copies, int)), np.repeat(case.light[None], copies, axis=0), visits


def _photons(setting, case):
    base = np.uint64(case.row["id"][0] + 1)

    def draw(copies):
        counted = np.zeros(case.window.shape, np.int32)
        keys = object_keys(base, np.arange(copies))
        shoot_spectra(counted, case.window, *_many(case, copies), setting.disperser, keys, setting.table)
        return counted

    return draw


def slabs(per_px):
    """Return the prepare of slabs, `per_px` to a pixel."""

    def prepare(setting, case):
        def draw(copies):
            image, reach = np.zeros(case.window.shape), np.repeat(case.row["reach"], copies)
            draw_spectra(
                image, case.window, *_many(case, copies), reach, np.zeros(copies), setting.disperser, setting.mixer,
                per_px=per_px,
            )  # fmt: skip
            return image

        return draw

    return prepare


def _preset(fidelity):
    def prepare(setting, case):
        def draw(copies):
            image = np.zeros(case.window.shape, np.float32)
            rows = case.row.take(np.zeros(copies, int))
            *_, counted = draw_dispersed(
                image, case.window, rows, _spectra(setting, case), setting.disperser, setting.wcs, setting.mixer,
                setting.exptime, tables=setting.table, beyond=Beyond(), response=None, maximum=1.0,
                variance=setting.variance, key=np.uint64(case.row["id"][0] + 1), fidelity=fidelity,
            )  # fmt: skip
            return image.astype(float) if counted is None else counted

        return draw

    return prepare


METHODS = (
    Method("reference", _reference),
    Method("photons", _photons),
    *(Method(f"slabs {per_px}", slabs(per_px)) for per_px in PER_PX),
    *(Method(name, _preset(name), preset=True) for name in ("standard", "noise_free")),
    Method("as the paper", peers.paper, peer=True),
)
