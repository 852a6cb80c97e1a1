"""SimSteps: load, check and run the ordered list of layers with their parameters.

Paper, section 4.3, where the layers are methods of SimSteps. Here each is a module of csstsim.layers, or a user's own
by dotted path, with

    Param, apply   its parameters (pydantic) and apply(state, param, rng) -> state
    STAGE          render, readout or level0
    UNITS          a pair, unit of input and output: "electron" or "DN"
    FRAME          a pair, input and output: "active" pixels or the "readout" with prescan and overscan (optional; by
                   default either)
    EXPOSURES      exposure types of the layer (optional; by default any)
    AFTER          layers that must come before it, if they are in the list (optional)
    BEFORE         layers of which one must come after it (optional)
    check          check(param, camera, pointing): raises InputError if these do not fit each other (optional)

csstsim.layer_contract checks a layer against this.
"""

from __future__ import annotations

import importlib
import pkgutil
import time
from dataclasses import dataclass, replace
from types import ModuleType
from typing import TYPE_CHECKING

import csstsim.layers
from csstsim.base.digest import digest, module_digest
from csstsim.base.errors import BlockedError, CsstsimError, InputError
from csstsim.base.help_page import explained
from csstsim.base.model import validate
from csstsim.base.process.progress import progress
from csstsim.simulation.exposure import Losses
from csstsim.simulation.observation import load_observation

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import Any

    from csstsim.base.rng import Streams
    from csstsim.base.types import PathLike
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGES = ("render", "readout", "level0")
NO_LAYERS = ("truth", "psf", "select")  # stages of the workflow that run no layers


def known_layers() -> list[str]:
    """Return the keywords of the layers in csstsim.layers.

    Returns
    -------
    list of str
        In lower case, sorted.
    """
    return sorted(info.name for info in pkgutil.iter_modules(csstsim.layers.__path__) if info.name != "param")


@dataclass(frozen=True)
class Step:
    """One entry of the list: the keyword as written, its module and its checked parameters."""

    keyword: str
    name: str  # names the step's random streams: the lower-case keyword, "#2" added on its second use
    module: ModuleType
    param: Any

    def describe(self) -> dict[str, dict[str, Any]]:
        """Return {keyword: parameters}, for the provenance of the products."""
        return {self.keyword: self.param.model_dump(mode="json")}


class SimSteps:
    """The layers of one kind of exposure, checked before any work.

    Parameters
    ----------
    file : str or Path
        Observation file; with `layers`, the name that errors give.
    kind : str, optional
        Exposure type of the list: SCIE, BIAS, DARK, FLAT, ... None: any.
    layers : sequence of mapping, optional
        A list in place of the file's: {keyword: parameters or None}, one entry per layer, in order.

    Raises
    ------
    InputError
        For an unknown keyword or parameter, a layer of csstsim given twice or in the wrong kind of exposure, a stage
        out of order, a layer whose unit or frame differs from the output of the layer before it, a list that does not
        end in a file, two exposure times, or losses that differ between layers.
    """

    @explained("observation")
    def __init__(
        self,
        file: PathLike,
        kind: str | None = None,
        layers: Sequence[Mapping[str, dict[str, Any] | None]] | None = None,
    ) -> None:
        self.file = file
        self._kind = kind
        self.steps: list[Step] = []
        uses: dict[str, int] = {}
        for number, entry in enumerate(load_observation(file).layers if layers is None else layers):
            [(keyword, param)] = entry.items()
            name = keyword.lower()
            uses[name] = uses.get(name, 0) + 1
            module = load_layer(keyword, file)
            if uses[name] > 1 and "." not in name:
                raise self._error("given twice", keyword)
            exposures: Any = getattr(module, "EXPOSURES", (kind,))
            if kind not in (None, *exposures):
                raise self._error("does not belong in this kind of exposure", keyword, kind, ", ".join(exposures))
            checked = validate(module.Param, param or {}, file, ("layers", number, keyword))
            self.steps.append(Step(keyword, name if uses[name] == 1 else f"{name}#{uses[name]}", module, checked))
        self._check_order()
        self._exptime = self._requested_time()
        self.field_dist = self._option_on("field_dist")
        for option in ("flat_fielding", "shutter_effect"):
            self._check_agree(option)

    def _option_on(self, option: str) -> bool:
        """Whether a layer has this option on."""
        return any(getattr(step.param, option, False) for step in self.steps)

    def _check_agree(self, option: str) -> None:
        """Raise InputError if layers differ in an option: objects and sky have the same optics and shutter."""
        values = {step.keyword: getattr(step.param, option) for step in self.steps if hasattr(step.param, option)}
        if len(set(values.values())) > 1:
            *_, last = values
            raise self._error(f"layers differ in {option}", f"{last}.{option}", values[last], "the same for all")

    def step(self, name: str) -> Step | None:
        """Return the step of a layer of csstsim.

        Parameters
        ----------
        name : str
            Keyword of the layer in lower case.

        Returns
        -------
        Step or None
            Keyword, module and parameters of the layer; None if the list does not contain it.
        """
        return next((step for step in self.steps if step.name == name), None)

    @property
    def losses(self) -> Losses:
        """The Losses of flux with this list."""
        return Losses(
            self._option_on("flat_fielding"), self._option_on("shutter_effect"), self.step("prnu_effect") is not None
        )

    @property
    def mask(self) -> bool:
        """Whether a truth mask is made."""
        return self._option_on("mask")

    @explained("observation")
    def check(self, camera: Camera, pointing: Pointing) -> None:
        """Let each layer check its parameters against the camera and an exposure.

        Parameters
        ----------
        camera : Camera
            The campaign's camera.
        pointing : Pointing
            The exposure.

        Raises
        ------
        InputError
            If a layer's parameters do not fit.
        BlockedError
            For an exposure that a layer cannot have; this message does not name the list.
        """
        for step in self.steps:
            try:
                getattr(step.module, "check", lambda *_: None)(step.param, camera, pointing)
            except BlockedError:
                raise
            except InputError as exc:
                raise InputError(str(exc), file=self.file, key=f"layers.{step.keyword}") from None

    def _error(self, message: str, keyword: str, value: object = None, allowed: object = None) -> InputError:
        return InputError(message, file=self.file, key=f"layers.{keyword}", value=value, allowed=allowed)

    def _check_order(self) -> None:
        stage = 0
        unit = "electron"
        frame = "active"
        names = [step.name for step in self.steps]
        for number, step in enumerate(self.steps, start=1):
            position, (unit_in, unit_out) = STAGES.index(step.module.STAGE), step.module.UNITS
            if position < stage:
                message = f"a layer of stage '{step.module.STAGE}' cannot follow one of stage '{STAGES[stage]}'"
                raise self._error(message, step.keyword, allowed=" then ".join(STAGES))
            if unit_in != unit:
                message = f"takes {unit_in}, but the layers before it leave {unit}"
                raise self._error(message, step.keyword, step.keyword, "gain turns electron into DN, once")
            frame_in, frame_out = getattr(step.module, "FRAME", (frame, frame))
            if frame_in != frame:
                message = f"works on the {frame_in} pixels, but the layers before it leave the {frame} ones"
                raise self._error(message, step.keyword, allowed="prescan_overscan turns active into readout, once")
            later = [name for name in getattr(step.module, "AFTER", ()) if name in names[number:]]
            if later:
                raise self._error(f"must come after {later[0]}", step.keyword)
            needed = getattr(step.module, "BEFORE", ())
            if needed and not set(needed) & set(names[number:]):
                raise self._error(f"must be followed by {' or '.join(needed)}", step.keyword)
            stage = position
            unit = unit_out
            frame = frame_out
        if (STAGES[stage], unit, frame) != ("level0", "DN", "readout"):
            needed = {"prescan_overscan": frame == "active", "gain": unit != "DN", "quantization_and_output": True}
            missing = next(name for name, lacks in needed.items() if lacks)
            raise self._error("a layer is missing: the list does not end in a Level-0 file", missing)

    def timed(self, pointing: Pointing) -> Pointing:
        """Return a pointing with the exposure time that the layers request.

        Parameters
        ----------
        pointing : Pointing
            A row of the survey table.

        Returns
        -------
        Pointing
            The same, or a copy with the exposure time of the layers [s], which is the same for every layer.
        """
        return pointing if self._exptime is None else replace(pointing, exptime=self._exptime)

    def _requested_time(self) -> float | None:
        """Return the exposure time [s] that the layers request; None: the pointing's."""
        times = {step.keyword: getattr(step.param, "exptime", None) for step in self.steps}
        times = {keyword: time for keyword, time in times.items() if time is not None}
        if len(set(times.values())) > 1:
            *_, last = times
            raise self._error("layers request different exposure times", last, times[last], "one for all, or null")
        exptime = next(iter(times.values()), None)
        if exptime == 0 and self._kind not in (None, "BIAS"):
            raise InputError("zero exposure time", file=self.file, key="exptime", value=0, allowed="0 for BIAS only")
        return exptime

    def __iter__(self) -> Iterator[Step]:
        return iter(self.steps)

    def stage(self, name: str) -> list[Step]:
        """Return the steps of one stage.

        Parameters
        ----------
        name : str
            "render", "readout" or "level0".

        Returns
        -------
        list of Step
            In the order of the list.
        """
        return [step for step in self.steps if name == step.module.STAGE]

    @property
    def shipped(self) -> bool:
        """Whether every layer is one of csstsim's."""
        return not self._users_modules

    @property
    def _users_modules(self) -> list[ModuleType]:
        """The modules of the user's own layers."""
        return _users_modules(self.steps)

    def has_own(self, stage: str) -> bool:
        """Whether a layer up to a stage is the user's, which may read any value of the camera.

        Parameters
        ----------
        stage : str
            A stage of the workflow: "select", "render", "readout", ...

        Returns
        -------
        bool
            True if there is such a layer.
        """
        return bool(_users_modules(self._up_to(stage)))

    def _up_to(self, stage: str) -> list[Step]:
        """Return the steps of a stage and those before it; all of them for a stage after the last."""
        stages = STAGES[: STAGES.index(stage) + 1] if stage in STAGES else () if stage in NO_LAYERS else STAGES
        return [step for step in self.steps if step.module.STAGE in stages]

    def digest(self, stage: str) -> str:
        """Return a digest of what in the list decides the pixels up to a stage.

        These are the layers, their parameters, the files of the user's own layers, the distortion, from render on the
        losses, and whether there is a mask (at render only if a user's layer may read it).

        Parameters
        ----------
        stage : str
            A stage of the workflow.

        Returns
        -------
        str
            16 hexadecimal digits.
        """
        steps = self._up_to(stage)
        modules = _users_modules(steps)
        parts: list[Any] = [[step.describe() for step in steps], *map(module_digest, modules), self.field_dist]
        if stage not in NO_LAYERS:
            parts += [self.losses, self.mask if modules or stage != "render" else None]
        return digest(parts)

    def describe(self) -> list[dict[str, dict[str, Any]]]:
        """Return the list of layers with all parameters.

        Returns
        -------
        list of dict
            {keyword: {parameter: value}}, one per layer.
        """
        return [step.describe() for step in self.steps]

    def run(self, state: State, stage: str, rng: Streams) -> State:
        """Run the layers of one stage.

        An exception inside a layer is annotated with its keyword. state.header["timing"] gets [name, wall time, CPU
        time] [s] of each layer, and state.header["own"] the names of what the user's own layers add to state.header.

        Parameters
        ----------
        state : State
            The simulation before the stage; its planes are changed in place.
        stage : str
            "render", "readout" or "level0".
        rng : Streams
            Random streams of the exposure and chip.

        Returns
        -------
        State
            The simulation after the stage.
        """
        for step in progress(self.stage(stage), stage):
            known = set(state.header)
            wall = time.perf_counter()
            cpu = time.process_time()
            try:
                state = step.module.apply(state, step.param, rng.layer(step.name))
            except CsstsimError:
                raise
            except Exception as exc:
                exc.add_note(f"in layer {step.keyword}")
                raise
            state.unit = step.module.UNITS[1]
            if _users_modules([step]):
                added = sorted(set(state.header) - known - {"own"})
                state.header["own"] = [*state.header.get("own", ()), *added]
            timing = [step.name, time.perf_counter() - wall, time.process_time() - cpu]
            state.header.setdefault("timing", []).append(timing)
        return state


def _users_modules(steps: Sequence[Step]) -> list[ModuleType]:
    """Return the modules of the user's own layers."""
    return [step.module for step in steps if not step.module.__name__.startswith(f"{csstsim.layers.__name__}.")]


def load_layer(keyword: str, file: PathLike | None = None) -> ModuleType:
    """Return the module of a layer: a keyword of csstsim, in upper or lower case, or the dotted path of a user's.

    file: the list that names it, for the message. Raises InputError if it is unknown or lacks a part.
    """
    name = keyword.lower()
    if "." not in keyword and name not in known_layers():
        allowed = f"{', '.join(known_layers())}; or the dotted path of your own, package.module"
        raise InputError("unknown layer", file=file, key="layers", value=keyword, allowed=allowed)
    path = keyword if "." in keyword else f"csstsim.layers.{name}"
    try:
        module = importlib.import_module(path)
    except Exception as exc:  # a user's module may fail in any way
        message = f"cannot import the layer: {type(exc).__name__} {exc}"
        raise InputError(message, file=file, key="layers", value=keyword) from exc
    missing = [part for part in ("Param", "apply", "STAGE", "UNITS") if not hasattr(module, part)]
    if missing:
        raise InputError(f"the layer's module lacks {', '.join(missing)}", file=file, key="layers", value=keyword)
    for part in ("UNITS", "FRAME"):
        pair = getattr(module, part, ("", ""))
        if not (isinstance(pair, tuple | list) and len(pair) == 2 and all(isinstance(word, str) for word in pair)):
            allowed = "a pair: input, output"
            raise InputError("must be a pair", file=file, key=f"layers.{keyword}.{part}", value=pair, allowed=allowed)
    if module.STAGE not in STAGES:
        raise InputError(
            "unknown stage", file=file, key=f"layers.{keyword}.STAGE", value=module.STAGE, allowed=", ".join(STAGES)
        )
    return module
