"""The contract test of your own layer: checks on 64 x 64 pixels what csstsim requires (simulation.sim_steps).

In your test:

    from csstsim.layer_contract import check_layer
    def test_contract():
        assert not check_layer("mylab.glint")

The layer runs with its default parameters, or those given, on a star over a flat sky, on a window that is not
square, and on an image of zeros, each across a corner where four readout channels meet. Faults are returned as lines of
text. A layer that cannot be loaded raises InputError, as it would in a campaign. The physics is not checked. The
shipped layers pass the same checks (tests/layers/test_contract.py).
"""

from __future__ import annotations

import gc
import inspect
import json
import random
import re
import weakref
from functools import cache
from typing import TYPE_CHECKING, get_args

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import ExposureType, Pointing
from csstsim.layers.param import LayerParam
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.simulation.exposure import Exposure, Losses
from csstsim.simulation.sim_steps import known_layers, load_layer
from csstsim.simulation.state import State

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from types import ModuleType
    from typing import Any

    from csstsim.base.types import AnyArray
    from csstsim.instrument.camera import Camera

CHIP = 9
SOURCE = re.compile(
    r"\b(paper|section|equation|eq\.|appendix|arxiv|doi|1[89]\d\d|20\d\d)\b|https?:|source: "
    r"|\w\.(yaml|csv|fits|conf|md)\b",
    re.I,
)  # a year stands for a reference
UNIT = re.compile(
    r"\[[^\]]+\]|%|\be-|\b(electrons?|DN|counts?|photons?|mag|magnitudes?|deg|degrees?|arcsec|arcmin|mas|rad|px|pixels?"
    r"|mm|um|nm|angstrom|seconds?|km|m2|Hz|bits?|bytes?|rows?|columns?|number|how many|part|share|fraction|ratio|factor"
    r"|density|times|dimensionless|probability|seed|index)\b"
)
FRAMES = ("active", "readout")
SHAPES = (64, 64), (48, 80)  # (ny, nx), px


def check_layer(
    layer: ModuleType | str, param: Mapping[str, Any] | None = None, state: Callable[[], State] | None = None
) -> tuple[str, ...]:
    """Return the faults of a layer.

    Parameters
    ----------
    layer : module or str
        The layer's module, or the name that an observation file would give.
    param : mapping, optional
        {parameter: value} in place of the defaults.
    state : callable, optional
        Function of no arguments that returns a new csstsim.simulation.state.State as the layer finds it, in place of
        the scenes above.

    Returns
    -------
    tuple of str
        One line per fault; empty if the layer fulfils the contract.

    Raises
    ------
    InputError
        For a layer that cannot be loaded, or parameters that it refuses.

    Examples
    --------
    >>> from csstsim.layer_contract import check_layer
    >>> check_layer("gain")
    ()
    """
    module = layer if inspect.ismodule(layer) else load_layer(layer)
    faults = form_faults(module)
    if faults:
        return faults
    try:
        given = module.Param.model_validate(param or {})
    except ValueError as exc:
        raise InputError(f"parameters refused: {exc}", key=module.__name__, value=param) from exc
    frames = FRAMES if not hasattr(module, "FRAME") else module.FRAME[:1]
    makers = [state] if state else [_maker(module, f, shape, peak) for f in frames for shape, peak in _scenes()]
    for make in makers:
        for fault in _run_faults(module, given, make):
            if fault not in faults:
                faults += (fault,)
    return faults


def form_faults(module: ModuleType) -> tuple[str, ...]:
    """Return the faults that are found without running the layer: docstrings, parameters, order.

    Parameters
    ----------
    module : module
        The layer's module.

    Returns
    -------
    tuple of str
        One line per fault.
    """
    faults = [f"{what} has no docstring" for what, thing in _documented(module) if not (thing.__doc__ or "").strip()]
    shipped = module.__name__.startswith("csstsim.")
    if shipped and module.__doc__ and not SOURCE.search(module.__doc__):
        faults.append("the module's docstring names no source: a paper and its year, a section, an equation, a file")
    return (*faults, *_declared_faults(module), *_param_faults(module))


def _documented(module: ModuleType) -> list[tuple[str, Any]]:
    """Return (name, object) of everything that needs a docstring."""
    named = [(name, getattr(module, name)) for name in ("Param", "apply", "check") if hasattr(module, name)]
    return [("the module", module), *named]


def _declared_faults(module: ModuleType) -> Iterator[str]:
    """Yield what is wrong with UNITS, FRAME, AFTER, BEFORE, EXPOSURES and the form of apply."""
    allowed: Sequence[str]
    for name, allowed in (("UNITS", ("electron", "DN")), ("FRAME", FRAMES)):
        value = getattr(module, name, allowed)
        if not isinstance(value, tuple) or len(value) != 2 or any(word not in allowed for word in value):
            yield f"{name} is {value!r}; it must be a pair, what it takes and gives, of {' or '.join(allowed)}"
    layers = known_layers()
    for name, allowed in (("AFTER", layers), ("BEFORE", layers), ("EXPOSURES", get_args(ExposureType))):
        value = getattr(module, name, ())
        if not isinstance(value, tuple):
            yield f"{name} is {value!r}; it must be a tuple of names"
            continue
        unknown = [word for word in value if word not in allowed and "." not in str(word)]
        if unknown:
            yield f"{name} names {unknown[0]!r}; known: {', '.join(allowed)}, or a dotted path"
    if not inspect.isfunction(module.apply):
        yield f"apply is {type(module.apply).__name__}; it must be a function of (state, param, rng)"
    elif list(inspect.signature(module.apply).parameters) != ["state", "param", "rng"]:
        yield f"apply takes {inspect.signature(module.apply)}; it must take (state, param, rng)"


def _param_faults(module: ModuleType) -> Iterator[str]:
    """Yield what is wrong with the parameters."""
    if not (inspect.isclass(module.Param) and issubclass(module.Param, LayerParam)):
        yield "Param is not a class of csstsim.layers.param.LayerParam"
        return
    for key, field in module.Param.model_fields.items():
        if field.is_required():
            yield f"parameter {key} has no default"
        if not field.description:
            yield f"parameter {key} has no description"
        elif field.annotation is not bool and _numeric(field.annotation) and not UNIT.search(field.description):
            yield f"parameter {key} is a number without a unit: {field.description!r}"


def _numeric(annotation: Any) -> bool:
    """Whether a parameter may be a number."""
    return annotation in (int, float) or any(_numeric(part) for part in getattr(annotation, "__args__", ()))


def _scenes() -> Iterator[tuple[tuple[int, int], float]]:
    """Yield (shape, peak [e- or DN] of the star and a hundredth of it of sky)."""
    yield from ((shape, 2e4) for shape in SHAPES)
    yield SHAPES[0], 0.0


@cache
def _camera() -> Camera:
    return load_camera(SHIPPED / "instrument")


def _maker(module: ModuleType, frame: str, shape: tuple[int, int], peak: float) -> Callable[[], State]:
    """Return a function that gives a fresh State of the shipped camera: chip 9 (r), where four channels meet."""
    from csstsim.detector.channels import ReadoutFrame

    camera = _camera()
    chip, (ny, nx) = camera.chips[CHIP], shape
    x0 = chip.detector.channel_nx - nx // 2
    y0 = chip.detector.channel_ny - ny // 2
    window = Window(x0, x0 + nx, y0, y0 + ny)
    pointing = Pointing(
        (*getattr(module, "EXPOSURES", ()), "SCIE")[0],
        60.0,
        -40.0,
        -113.4,
        "2027-06-26T20:35:58",
        150.0,
        (6778.137, 0.0, 0.0),
        (0.0, 5.743, 5.09),
    )
    y, x = np.indices(shape)
    image = (peak * (0.01 + np.exp(-0.5 * ((x - 0.4 * nx) ** 2 + (y - 0.6 * ny) ** 2) / 4.0))).astype(np.float32)
    if frame == "readout":
        image = ReadoutFrame.of(chip.detector, window).embed(image)
    exposure = Exposure(pointing, chip, window, ChipWCS(chip, pointing), camera, losses=Losses(prnu=True))
    return lambda: State(exposure, image.copy(), unit=module.UNITS[0])


def _run_faults(module: ModuleType, param: LayerParam, make: Callable[[], State]) -> Iterator[str]:
    """Yield what goes wrong when the layer runs on the states of `make`."""
    global_state = repr(np.random.get_state()), random.getstate()  # noqa: NPY002 - the very thing that must not change
    results = []
    for seed in (1, 1, 2):
        state = make()
        exposure = state.exposure
        rng = Streams(seed, "10100000001", state.chip.id, module.__name__.lower())
        try:
            result = module.apply(state, param, rng)
        except Exception as exc:  # a user's layer may fail in any way
            yield f"apply raised {type(exc).__name__}: {exc}"
            return
        if not isinstance(result, State):
            yield f"apply returned {type(result).__name__}; it must return the state"
            return
        if result.exposure is not exposure:
            yield "changes state.exposure: its pointing, chip, window, wcs, filter and telescope must stay"
            return
        results.append((result.image, result.header))
    (image, header), (again, header_again), (other, _) = results
    yield from _image_faults(module, state, make(), image)
    yield from _header_faults(header)
    if not np.array_equal(image, again, equal_nan=True) or repr(header) != repr(header_again):
        yield "the same seed gives another image or header: sample from rng, by words, and store nothing between calls"
    if global_state != (repr(np.random.get_state()), random.getstate()):  # noqa: NPY002
        yield "uses numpy's or Python's global random numbers; sample from rng"
    references = weakref.ref(state), weakref.ref(state.image)
    del state, result, results, image, again, other
    if any(ref() is not None for ref in references):
        gc.collect()  # of cycles alone: in a large process it takes half a second
    if any(ref() is not None for ref in references):
        yield "keeps a reference to the state or its image after apply; a chip's image is 340 MB"


def _image_faults(module: ModuleType, state: State, before: State, image: AnyArray) -> Iterator[str]:
    """Yield the faults of the image that a layer returns; before: a state like the one that the layer got."""
    from csstsim.detector.channels import ReadoutFrame

    shape = before.image.shape
    kinds = ["float32", "uint16"][: 1 + (module.STAGE == "level0")]
    if getattr(module, "FRAME", FRAMES[:1] * 2) == FRAMES:
        shape = ReadoutFrame.of(state.chip.detector, state.window).shape
    if not isinstance(image, np.ndarray) or image.shape != shape:
        yield f"returns an image of shape {np.shape(image)}; it must be {shape}"
    elif image.dtype.name not in kinds:
        yield f"returns an image of {image.dtype}; it must be {' or '.join(kinds)}"
    elif not np.isfinite(image).all():
        yield "returns pixels that are not finite"
    elif type(image) is not np.ndarray or not (
        image.flags.c_contiguous and image.flags.writeable and image.dtype.isnative
    ):
        yield "returns an image that is not a plain array in C order, of native bytes, that can be written"
    if state.counted is not None and (state.counted.dtype != np.int32 or state.counted.shape != before.window.shape):
        yield f"returns counted electrons of {state.counted.dtype}, {state.counted.shape}; int32, {before.window.shape}"


def _header_faults(header: Mapping[str, Any]) -> Iterator[str]:
    """Yield the faults of a layer's entries of the header: {name: value}, to be stored as JSON."""
    for name, value in header.items():
        try:
            same = isinstance(name, str) and json.loads(json.dumps(value, allow_nan=False)) == value
        except (TypeError, ValueError):
            same = False
        if not same:
            yield f"header {name!r} is {type(value).__name__} {value!r}: not a JSON value (float, int, str, list)"
