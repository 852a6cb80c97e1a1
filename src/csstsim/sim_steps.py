"""SimSteps: load, check and run the ordered list of (layer, obs_param). The program on one page.

Paper, section 4.3. The one change of form: SimSteps lists the layers instead of holding them as methods;
each layer is a module of csstsim.layers (or a user's own, by dotted path) with Param, apply, STAGE, UNITS.
"""

import importlib
import pkgutil
import time
from dataclasses import dataclass
from types import ModuleType

import csstsim.layers
from csstsim.config import load_observation, validate
from csstsim.errors import CsstsimError, InputError
from csstsim.rng import Streams

STAGES = ("render", "readout", "level0")


def known_layers():
    """Return the keywords of the layers in csstsim.layers, sorted."""
    return sorted(info.name for info in pkgutil.iter_modules(csstsim.layers.__path__) if info.name != "param")


@dataclass(frozen=True)
class Step:
    """One entry of the list: the keyword as written, its module and its checked parameters."""

    keyword: str
    name: str  # names the step's random streams: the lower-case keyword, "#2" added on its second use
    module: ModuleType
    param: object

    def describe(self):
        """Return {keyword: parameters}, for the provenance of the products."""
        return {self.keyword: self.param.model_dump(mode="json")}


class SimSteps:
    """The layers of one kind of exposure, checked before any work.

    Raises InputError for an unknown keyword or parameter, a stage that goes backwards, or a layer whose
    unit is not what the one before it leaves.
    """

    def __init__(self, file):
        self.file = file
        self.steps = []
        uses = {}
        for number, entry in enumerate(load_observation(file).layers):
            [(keyword, param)] = entry.items()
            name = keyword.lower()
            uses[name] = uses.get(name, 0) + 1
            module = _load_layer(keyword, file)
            checked = validate(module.Param, param or {}, file, ("layers", number, keyword))
            self.steps.append(Step(keyword, name if uses[name] == 1 else f"{name}#{uses[name]}", module, checked))
        self._check_order()

    def _check_order(self):
        stage, unit = 0, "electron"
        for step in self.steps:
            here, (takes, gives) = STAGES.index(step.module.STAGE), step.module.UNITS
            if here < stage:
                raise InputError(
                    f"a layer of stage '{step.module.STAGE}' cannot follow one of stage '{STAGES[stage]}'",
                    file=self.file, key=f"layers.{step.keyword}", allowed=" then ".join(STAGES),
                )  # fmt: skip
            if takes != unit:
                raise InputError(
                    f"takes {takes}, but the layers before it leave {unit}",
                    file=self.file, key=f"layers.{step.keyword}", value=step.keyword,
                    allowed="gain turns electron into DN, once",
                )  # fmt: skip
            stage, unit = here, gives

    def __iter__(self):
        return iter(self.steps)

    def stage(self, name):
        """Return the steps of one stage: 'render', 'readout' or 'level0'."""
        return [step for step in self.steps if name == step.module.STAGE]

    def describe(self):
        """Return the list of {keyword: parameters}."""
        return [step.describe() for step in self.steps]

    def run(self, state, stage, seed):
        """Run the layers of one stage on `state` and return it.

        Wall and CPU seconds of each layer are appended to state.header["timing"] as [name, wall, cpu].
        An exception inside a layer is annotated with obsid, chip and layer.
        """
        for step in self.stage(stage):
            wall, cpu = time.perf_counter(), time.process_time()
            streams = Streams(seed, state.pointing.obsid, state.chip.id, step.name)
            try:
                state = step.module.apply(state, step.param, streams)
            except CsstsimError:
                raise
            except Exception as exc:
                exc.add_note(f"in obsid {state.pointing.obsid}, chip {state.chip.id}, layer {step.keyword}")
                raise
            state.unit = step.module.UNITS[1]
            timing = [step.name, time.perf_counter() - wall, time.process_time() - cpu]
            state.header.setdefault("timing", []).append(timing)
        return state


def _load_layer(keyword, file):
    name = keyword.lower()
    if "." not in keyword and name not in known_layers():
        raise InputError("unknown layer", file=file, key="layers", value=keyword, allowed=", ".join(known_layers()))
    path = keyword if "." in keyword else f"csstsim.layers.{name}"
    try:
        module = importlib.import_module(path)
    except ImportError as exc:
        raise InputError(f"cannot import the layer: {exc}", file=file, key="layers", value=keyword) from exc
    missing = [part for part in ("Param", "apply", "STAGE", "UNITS") if not hasattr(module, part)]
    if missing:
        raise InputError(f"the layer's module lacks {', '.join(missing)}", file=file, key="layers", value=keyword)
    return module
