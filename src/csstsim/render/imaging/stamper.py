"""The stamps of a scene's objects: kind and size of each stamp, and the part of the PSF's box that it contains."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.render.extended import POINT, parts_at
from csstsim.render.imaging.galaxy_stamp import Plan, galaxy_stamp, plan_galaxies
from csstsim.render.imaging.point_stamp import point_stamp
from csstsim.render.psf_mixture import Mixer
from csstsim.render.scene import Scene

if TYPE_CHECKING:
    from csstsim.optics.scatter.scattered_light import Scattered
    from csstsim.render.canvas import Box
    from csstsim.render.extended import Part


@dataclass(frozen=True, eq=False)
class Stamper:
    """Stamps of n objects."""

    mixer: Mixer
    scene: Scene
    reach: IntArray  # (n,) px, half the side of each stamp
    plan: Plan  # of the galaxies
    cored: bool  # the PSF's box is faded out, because there is a wing

    @classmethod
    def of(cls, mixer: Mixer, scene: Scene, scattered: Scattered | None, lit: BoolArray | bool = True) -> Self:
        """Return the Stamper of a Scene; scattered: a Scattered, or None: only stamps; lit: (n,) has any light."""
        reach = np.asarray(scene.reach, int)
        cored = scattered is not None and scattered.wing is not None
        if scattered is not None and not cored:  # without a wing, a stamp holds the whole box
            reach = np.maximum(reach, math.ceil(mixer.half))
        return cls(mixer, scene, reach, plan_galaxies(scene, reach, mixer.half, lit & scene.extended), cored)

    @cached_property
    def core(self) -> FloatArray | None:
        """The fraction of each cell of the PSF that is rendered, or None: all of it."""
        return self.mixer.core if self.cored else None

    def alone(self, i: int) -> Stamper:
        """Return the Stamper of object i alone."""
        row = np.array([i])
        return Stamper(self.mixer, self.scene.take(row), self.reach[row], self.plan.take(row), self.cored)

    def moved(self, x: float, y: float) -> Stamper:
        """Return the Stamper of a single object moved to x, y."""
        return replace(self, scene=replace(self.scene, x=np.array([x]), y=np.array([y])))

    def stamp(
        self, i: int, node_electrons: FloatArray, bounds: Box | None, many: bool = False
    ) -> tuple[FloatArray, float]:
        """Return (stamp, light): object i on the pixels of `bounds`, float64, and the light of its whole stamp.

        node_electrons (k, 4): electrons from each of its PSF nodes and sub-band; bounds: (x0, x1, y0, y1), half-open,
        the part of the stamp to compute, or None; many: whether many galaxies share size and nodes.
        """
        return (
            galaxy_stamp(self, i, node_electrons, bounds, many)
            if self.plan.size[i]
            else point_stamp(self, i, node_electrons, bounds)
        )

    def parts(self, i: int) -> tuple[Part, ...]:
        """Return the render.extended.Parts of object i."""
        return parts_at(self.scene, i) if self.plan.size[i] else POINT
