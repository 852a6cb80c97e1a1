"""A drawing method: when it may render an object, its cost, its predicted error, and how it renders.

Each method is one file of render.imaging.methods or render.slitless.methods. render.imaging.register and
render.slitless.register list the methods, and render.policy chooses among them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.render.drawn_table import NONE
from csstsim.render.error_model import allowed_error, noise, psf_error, stamp_error
from csstsim.render.settings import load_numbers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from csstsim.base.types import BoolArray
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.render.canvas import Canvas
    from csstsim.render.drawing import Drawing
    from csstsim.render.scene import Scene
    from csstsim.render.settings import Fidelity, Preset
    from csstsim.render.slitless.traces import Traces

NOT_RENDERED = 0  # code of objects without electrons; no method has it
ELECTRONS_MAX = 1e15  # of an object


@dataclass(frozen=True, eq=False)
class Targets:
    """n objects to be rendered, and what the choice of their methods depends on."""

    scene: Scene
    drawing: Drawing
    maximum: float = 1.0  # largest response; photons are drawn for `maximum` times the electrons
    disperser: Disperser | None = None  # of a spectroscopic chip; scene.electrons are then those of the first order

    def __len__(self) -> int:
        return len(self.scene)

    @cached_property
    def electrons(self) -> FloatArray:
        """(n,) expected electrons of each object."""
        return self.scene.electrons.sum(axis=1)

    @cached_property
    def snr(self) -> FloatArray:
        """(n,) S/N of each object; with a grating, over the pixels that its spectrum covers."""
        electrons = self.scene.total_electrons
        length = 0.0 if self.disperser is None else self.disperser.length
        return electrons / noise(self.scene, electrons, self.drawing.variance, length)

    @property
    def preset(self) -> Preset:
        """The accuracy limits of the fidelity."""
        return load_numbers().presets[cast("Fidelity", self.drawing.fidelity)]

    @property
    def allowed_error(self) -> FloatArray:
        """(n,) allowed error of each object as a fraction of its S/N."""
        return allowed_error(self.snr, load_numbers().error, self.drawing.psf.oversampling, self.preset.eps)

    @property
    def psf_error(self) -> FloatArray:
        """(n,) predicted errors of the PSF's density between its stored cells, in units of each object's own noise."""
        return psf_error(self.snr, load_numbers().error, self.drawing.psf.oversampling)

    @property
    def stamp_error(self) -> FloatArray:
        """(n,) predicted errors of the PSF, of a point's cut-off stamp and of a galaxy's transform, likewise."""
        return stamp_error(self.scene, self.shown, self.snr, load_numbers().error, self.drawing.psf.oversampling)

    @property
    def reach(self) -> AnyArray:
        """(n,) half the side of each stamp [px]."""
        assert self.scene.reach is not None  # select gives it
        return self.scene.reach

    @property
    def wing(self) -> FloatArray:
        """(n,) radius to which each wing exceeds the noise [px]."""
        assert self.scene.wing is not None  # select gives it
        return self.scene.wing

    @property
    def shown(self) -> FloatArray:
        """(n,) distance to which a point is rendered [px]: its wing takes over where its stamp ends."""
        return np.maximum(self.reach, self.wing)


class Rendered(NamedTuple):
    """What a method rendered of n objects, or of n visits of objects to the pieces of a grating.

    * electrons: (n,), of visits (n, orders): electrons on the window; whole numbers if they were counted
    * box: (n, 4), of visits (n, orders, 4): x0, x1, y0, y1 of the chip's pixels, half-open; zeros: none
    * flags: catalog.flags, (n,) or one for all
    * ms: (n,) CPU time [ms]; None: the time of all is divided among them, by predicted cost (visits: equally)
    """

    electrons: FloatArray | IntArray
    box: IntArray
    flags: IntArray | int = 0
    ms: FloatArray | None = None


class Batch(NamedTuple):
    """n objects of an imaging chip to be rendered by one method; keys: (n,) uint64, of their random numbers."""

    scene: Scene
    drawing: Drawing
    keys: IntArray


class SpectraBatch(NamedTuple):
    """n objects of a spectroscopic chip to be rendered by one method.

    * traces: their spectra and their v visits to the pieces of the grating
    * keys: (v,) uint64, of the visits' random numbers
    * allowed: (n,) allowed error of each object as a fraction of its S/N
    """

    scene: Scene
    drawing: Drawing
    traces: Traces
    keys: IntArray
    allowed: FloatArray


@dataclass(frozen=True, kw_only=True)
class Method:
    """A drawing method as the policy needs it. Its functions take the Targets of n objects.

    * name: in the truth table, at most 10 characters
    * code: in Choice.method, 1 to 127, of no other method of the register
    * allowed: return (n,) bool, whether it may render each object
    * cost: return (n,) CPU time [ns]
    * error: return (n,) predicted errors, in units of each object's own noise
    * preferred: it renders all objects that it may, whatever its cost and error
    * stamps: it renders each object on a stamp, whose side the truth table gives
    """

    name: str
    code: int
    allowed: Callable[[Targets], BoolArray]
    cost: Callable[[Targets], FloatArray]
    error: Callable[[Targets], FloatArray]
    preferred: bool = False
    stamps: bool = False


@dataclass(frozen=True, kw_only=True)
class ImagingMethod(Method):
    """A drawing method of imaging chips; draw: render a Batch on a Canvas."""

    draw: Callable[[Canvas, Batch], Rendered]


def no_coarse_bins(targets: Targets) -> BoolArray:
    """Return (n,) False: all spectra have bins of full resolution."""
    return np.zeros(len(targets), bool)


@dataclass(frozen=True, kw_only=True)
class SpectraMethod(Method):
    """A drawing method of spectroscopic chips.

    * draw: render a SpectraBatch on a Canvas
    * chunk: largest number of objects in a batch; chunk_coarse: the same, of objects in coarse bins
    * coarse: return (n,) bool, whether bins of a pixel (Disperser.coarse) are fine enough for each object
    * electrons_max: largest number of electrons of a spectrum; brighter spectra are flagged as bad and not rendered
    """

    draw: Callable[[Canvas, SpectraBatch], Rendered]
    chunk: int = 2048
    chunk_coarse: int = 2048
    coarse: Callable[[Targets], BoolArray] = no_coarse_bins
    electrons_max: float = ELECTRONS_MAX


def names_of(codes: IntArray, methods: Sequence[Method]) -> AnyArray:
    """Return the names (n,) of codes of methods, as in the truth table."""
    names = np.full(1 + max(method.code for method in methods), NONE, "U10")
    for method in methods:
        names[method.code] = method.name
    return names[codes]
