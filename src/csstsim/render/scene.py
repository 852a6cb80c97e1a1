"""The objects of a chip as plain arrays: what every compiled renderer needs to know of them, and no more."""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from csstsim.catalog.table import GALAXY

DISK, BULGE = 1.0, 4.0  # Sersic indices of the two components


@dataclass(frozen=True, eq=False)
class Scene:
    """n objects; components are disk and bulge, a point has one of index 0."""

    ids: np.ndarray  # (n,) int64
    x: np.ndarray  # (n,) float64, chip pixel
    y: np.ndarray
    electrons: np.ndarray  # (n, 4) float64, of the exposure, by sub-band
    light: np.ndarray  # (n, 2) float64, share of each component
    sersic: np.ndarray  # (n, 2, 3) float64: index, b, half-light radius [arcsec]
    matrix: np.ndarray  # (n, 2, 2) float64, pixel per arcsec: shape, lensing and the sky's map to pixels
    node: np.ndarray  # (n, k) int64, PSF nodes
    weight: np.ndarray  # (n, k) float64, of the nodes
    outside: np.ndarray  # (n,) bool: outside the grid of PSF nodes

    def __len__(self):
        return len(self.x)

    def take(self, rows):
        """Return the objects of an index array, in that order."""
        return Scene(**{name: values[rows] for name, values in vars(self).items()})


def make_scene(objects, wcs, psf, exptime):
    """Return the Scene of an ObjectTable as catalog.selection.select leaves it (all of its rows must be drawable).

    What an object makes no use of, a point's shape or the size of a component without light, may be anything there.
    """
    flux = np.stack([objects[f"flux{i}"] for i in range(4)], axis=1) * exptime
    galaxy = objects["obj_type"] == GALAXY
    bulge = np.where(galaxy, objects["bulge_frac"].astype(float), 0.0)
    light, sersic = np.stack([1 - bulge, bulge], axis=1), np.zeros((len(objects), 2, 3))
    for i, (index, name) in enumerate(((DISK, "size_disk"), (BULGE, "size_bulge"))):
        size = np.where(light[:, i] > 0, objects[name].astype(float), 0.0)
        sersic[galaxy, i] = np.stack(np.broadcast_arrays(index, sersic_b(index), size[galaxy]), axis=-1)
    node, weight, outside = psf.weights(objects["x"], objects["y"])
    return Scene(
        objects["id"].astype(np.int64), objects["x"].astype(float), objects["y"].astype(float), flux,
        light, sersic, shape_matrix(objects, wcs), node.astype(np.int64), weight,
        outside,
    )  # fmt: skip


def sersic_b(index):
    """Return b(n): half of a Sersic profile's light lies within r_e. Exact (inverse incomplete gamma function)."""
    return gammaincinv(2 * np.asarray(index, dtype=float), 0.5)


def shape_matrix(objects, wcs):
    """Return (n, 2, 2): intrinsic shear, then lensing, both of the sky, then d(pixel) / d(arcsec).

    Shapes refer to east and north at the catalogue's place. Aberration carries them along unturned; east at the
    apparent place, up to 26" off, is another direction near a pole. A point has no shape, whatever its columns say.
    """
    jacobian = wcs.jacobian(objects["ra_orig"], objects["dec_orig"], seen=(objects["ra"], objects["dec"]))
    galaxy, names = objects["obj_type"] == GALAXY, ("e1", "e2", "kappa", "gamma1", "gamma2")
    e1, e2, kappa, gamma1, gamma2 = (np.where(galaxy, objects[name].astype(float), 0.0) for name in names)
    shear = np.array([[1 + e1, e2], [e2, 1 - e1]]) / np.sqrt(1 - e1**2 - e2**2)
    # The lens maps the image to the source by [[1 - k - g1, -g2], [-g2, 1 - k + g1]]; light goes the other way
    determinant = (1 - kappa) ** 2 - gamma1**2 - gamma2**2
    lens = np.array([[1 - kappa + gamma1, gamma2], [gamma2, 1 - kappa - gamma1]]) / determinant
    return np.einsum("nij,jkn,kln->nil", jacobian, lens, shear)
