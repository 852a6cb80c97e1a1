"""The objects of a chip as plain arrays, as the compiled renderers need them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.catalog.galaxy_shapes.components import components
from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.catalog.table import GALAXY

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from csstsim.base.image_wcs import ImageWCS
    from csstsim.catalog.table import ObjectTable
    from csstsim.optics.geometry.wcs import ChipWCS
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.render.parts.spots import Spots


@dataclass(frozen=True, eq=False)
class Scene:
    """n objects, or parts of objects (render.parts.object_parts).

    The two components are disk and bulge; a component of Sersic index 0 is a point.
    """

    ids: IntArray  # (n,) int64
    x: FloatArray  # (n,) float64, chip pixel
    y: FloatArray
    electrons: FloatArray  # (n, 4) float64, of the exposure, by sub-band
    component_fractions: FloatArray  # (n, 2) float64, of the electrons, in each component
    sersic: FloatArray  # (n, 2, 3) float64: index, b, half-light radius [arcsec]
    matrix: FloatArray  # (n, 2, 2) float64, pixel per arcsec: shape, lensing and the sky's map to pixels
    node: IntArray  # (n, k) int64, PSF nodes
    weight: FloatArray  # (n, k) float64, of the nodes
    outside: BoolArray  # (n,) bool: outside the grid of PSF nodes
    reach: AnyArray | None = None  # (n,) px, half the side of the stamp
    wing: FloatArray | None = None  # (n,) px, radius to which the wing exceeds the noise; 0: nowhere
    # Of a scene with knots or images: rows beyond the objects are parts of them, with a fraction of their electrons
    parent: IntArray | None = None  # (n,) int64, object that a row belongs to; None: one row for each object
    fraction_of_parent: FloatArray | None = None  # (n,) of the object's electrons; None: all
    spot: IntArray | None = None  # (n,) int64, group of `spots` that is the profile, or -1; None: nowhere
    spots: Spots | None = None
    trail_fraction: FloatArray | None = None  # (n,) of the object's electrons, in this piece of its trail; None: all

    def __len__(self) -> int:
        return len(self.x)

    def take(self, rows: IntArray) -> Scene:
        """Return the objects of an index array, in that order."""
        kept = {name: values for name, values in vars(self).items() if name == "spots" or values is None}
        return Scene(**kept, **{name: values[rows] for name, values in vars(self).items() if name not in kept})

    def sized(self, reach: ArrayLike, wing: ArrayLike = 0.0) -> Scene:
        """Return the Scene with these half sides of stamps and radii of wings [px], (n,) or one for all."""
        n = len(self)
        return replace(self, reach=np.broadcast_to(reach, n).copy(), wing=np.broadcast_to(wing, n).copy())

    @property
    def total_electrons(self) -> FloatArray:
        """(n,) electrons of the object of which each is a piece."""
        electrons = self.electrons.sum(axis=1)
        return electrons if self.trail_fraction is None else electrons / self.trail_fraction

    @property
    def extended(self) -> BoolArray:
        """(n,) bool: whether the object is not a point."""
        sersic: BoolArray = np.any((self.sersic[:, :, 0] > 0) & (self.component_fractions > 0), axis=1)
        return sersic if self.spot is None else sersic | (self.spot >= 0)

    @property
    def objects(self) -> int:
        """The number of objects: rows from there on are parts of them."""
        return len(self) if self.parent is None else int(self.parent.max(initial=-1)) + 1


def make_scene(objects: ObjectTable, wcs: ChipWCS, psf: PsfSet, exptime: float) -> Scene:
    """Return the Scene of an ObjectTable from catalog.selection.select, all of whose rows must be drawable."""
    flux = np.stack([objects[f"flux{i}"] for i in range(4)], axis=1) * exptime
    galaxy = objects["obj_type"] == GALAXY
    parts = components(objects)
    sersic = np.zeros((len(objects), 2, 3))
    for i, (_, index, size) in enumerate(parts):
        index = index[galaxy] if isinstance(index, np.ndarray) else index
        sersic[galaxy, i] = np.stack(np.broadcast_arrays(index, sersic_b(index), size[galaxy]), axis=-1)
    node, weight, outside = psf.weights(objects["x"], objects["y"])
    names = ("reach", "reach"), ("wing", "wing"), ("trail_fraction", "trail_share")
    known: dict[str, Any] = {name: objects[column] for name, column in names if column in objects}
    scene = Scene(
        objects["id"].astype(np.int64),
        objects["x"].astype(float),
        objects["y"].astype(float),
        flux,
        np.stack([light for light, *_ in parts], axis=1),
        sersic,
        shape_matrix(objects, wcs),
        node.astype(np.int64),
        weight,
        outside,
        **known,
    )
    if not {"knots", "image_file"} & set(objects):
        return scene
    from csstsim.render.parts.object_parts import with_parts  # which needs this module's Scene

    circular = objects.with_columns(e1=np.zeros(len(objects)), e2=np.zeros(len(objects)))
    return with_parts(scene, objects, psf, lambda rows: shape_matrix(circular.take(rows), wcs))


def shape_matrix(objects: ObjectTable, wcs: ChipWCS | ImageWCS) -> FloatArray:
    """Return (n, 2, 2): intrinsic shear, then lensing, both on the sky, then d(pixel) / d(arcsec).

    Shapes refer to east and north at the catalogue position. Aberration does not rotate them, but near a pole east at
    the apparent position, up to 26" away, is another direction. The shape columns of points are ignored.
    """
    jacobian = wcs.jacobian(objects["ra_orig"], objects["dec_orig"], seen=(objects["ra"], objects["dec"]))
    galaxy = objects["obj_type"] == GALAXY

    def of_galaxies(name: str) -> FloatArray:
        return np.where(galaxy, objects[name].astype(float), 0.0)

    e1 = of_galaxies("e1")
    e2 = of_galaxies("e2")
    kappa = of_galaxies("kappa")
    gamma1 = of_galaxies("gamma1")
    gamma2 = of_galaxies("gamma2")
    shear = np.array([[1 + e1, e2], [e2, 1 - e1]]) / np.sqrt(1 - e1**2 - e2**2)
    # The lens maps the image to the source by [[1 - k - g1, -g2], [-g2, 1 - k + g1]]; light goes the other way
    determinant = (1 - kappa) ** 2 - gamma1**2 - gamma2**2
    lens = np.array([[1 - kappa + gamma1, gamma2], [gamma2, 1 - kappa - gamma1]]) / determinant
    return np.einsum("nij,jkn,kln->nil", jacobian, lens, shear)
