"""Choose the family of profiles of a frame's galaxies: discs with bulges, or Sersic profiles.

One galaxy seldom tells its family, some hundred do. The probability of each bright galaxy's pixels is compared between
the families. No galaxy counts for more than CLIP, because a blend, or structure that no profile has, fits one of them
by chance. The first family is taken unless another is much more likely, and by more than the noise of the sum, so it is
that of frames with few galaxies and of mixed ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.measure.light.total_light import total_light

if TYPE_CHECKING:
    from csstsim.measure.detection.combine import Detections
    from csstsim.measure.light.profile_tables import ProfileTables

SNR_MIN = 15.0  # of the sources that are compared
SOURCES_MAX = 600
POINT_MAX = 0.1  # probability of a point above which a source is no galaxy
# ln of the ratio of probabilities: maximum of one galaxy; minimum of all for a family other than the first
CLIP = 3.0
CERTAIN = 10.0
SIGMAS = 3.0  # minimum of all over the noise of the sum


def likelier_family(
    found: Detections,
    table: Mapping[str, AnyArray],
    unusable: IntArray,
    counted: FloatArray,
    families: Sequence[ProfileTables],
) -> ProfileTables:
    """Return the tables of the family that the bright galaxies of a frame have; others as for `total_light`."""
    fits = [total_light(found, table, unusable, counted, tables) for tables in families]
    galaxies = fits[0]["point"] < POINT_MAX
    best, best_gain = families[0], CERTAIN
    for tables, fit in zip(families[1:], fits[1:], strict=True):
        gains = np.clip((fit["evidence"] - fits[0]["evidence"])[galaxies], -CLIP, CLIP)
        gain = np.nansum(gains)
        if gain > max(best_gain, SIGMAS * np.nansum(gains**2) ** 0.5):
            best, best_gain = tables, gain
    return best
