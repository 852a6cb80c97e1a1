"""The Sersic components of the objects of a table: the only definition of a galaxy's profiles."""

import numpy as np

from csstsim.catalog.table import GALAXY
from csstsim.profiles.sersic import BULGE, DISK


def components(table):
    """Return ((light, index, size), ...) of disk and bulge of an ObjectTable's objects.

    light (n,): share of the object's light; index: Sersic's; size (n,): half-light radius [arcsec]. A point is a disk
    of size 0. The table may hold any value for a point's shape and for the size of a component without light.
    """
    galaxy = table["obj_type"] == GALAXY
    bulge = np.where(galaxy, table["bulge_frac"].astype(float), 0.0)
    parts = (1 - bulge, DISK, "size_disk"), (bulge, BULGE, "size_bulge")
    return tuple(
        (light, index, np.where(galaxy & (light > 0), table[name].astype(float), 0.0)) for light, index, name in parts
    )
