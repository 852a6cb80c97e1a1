"""Run every method on every case; one row with cost and error for each.

A `Bench` has what differs between imaging and dispersed light: objects, methods, truth and measures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np
from galsim import GalSimError

from csstsim.base.process.progress import progress
from csstsim.base.types import AnyArray, FloatArray

if TYPE_CHECKING:
    from csstsim.studies.bench.imaging.cases import Case
    from csstsim.studies.bench.imaging.methods import Method
    from csstsim.studies.bench.setting import Setting

SLOW = 1.0  # CPU seconds of one object above which its set-up is negligible
TOO_LONG = 5.0  # maximum CPU time for drawing more electrons, in units of the requested one
CaseT = TypeVar("CaseT", bound="Case")
Draw: TypeAlias = Callable[[int], AnyArray]  # argument: number of copies of an object; returns the image [electron]


class Measured(NamedTuple):
    """The image of an object of unit flux, CPU seconds of an object, electrons drawn (infinite if none is random)."""

    image: AnyArray
    cost: float
    drawn: float


@dataclass(frozen=True)
class Bench(Generic[CaseT]):
    """make_cases(setting, count, seed, largest) -> cases, which have star, electrons, `about` and `brighter`.

    truth(setting) -> function of a case; standard(setting, case) -> image; errors(setting, case, image, truth, drawn)
    -> (errors, chances), each (len(names),), of images per unit of flux; methods: imaging Methods; goals: {name:
    largest bias}; shown: names to print.
    """

    methods: tuple[Method[CaseT], ...]
    make_cases: Callable[[Setting, int, int, float], Sequence[CaseT]]
    truth: Callable[[Setting], Callable[[CaseT], FloatArray]]
    standard: Callable[[Setting, CaseT], FloatArray]
    errors: Callable[[Setting, CaseT, FloatArray, FloatArray, float], tuple[FloatArray, FloatArray]]
    names: tuple[str, ...]
    goals: dict[str, float]
    shown: tuple[str, ...]


def sweep(
    bench: Bench[CaseT],
    setting: Setting,
    cases: Sequence[CaseT],
    methods: Sequence[Method[CaseT]],
    *,
    seconds: float,
    electrons: float,
) -> list[dict[str, Any]]:
    """Return a list of rows (dicts, see `row`).

    A cost is measured over at least `seconds` of CPU time, or one object if that takes longer; methods that draw random
    electrons draw each object until it has `electrons`.
    """
    truth = bench.truth(setting)
    rows = []
    for kind in {case.about()["kind"] for case in cases}:  # compile and warm up before anything is timed
        of_kind = (case for case in cases if case.about()["kind"] == kind)
        faintest = min(of_kind, key=lambda case: case.electrons)
        for method in methods:
            measure_case(method, setting, faintest.brighter(2000.0), 0.0, 0.0)
            measure_case(method, setting, faintest, 0.0, 0.0)
    for case in progress(cases, "objects"):
        direct = truth(case)
        reference = bench.standard(setting, case) / case.electrons
        for method in methods:
            rows.append(row(bench, method, setting, case, direct, reference, seconds, electrons))
    return rows


def row(
    bench: Bench[CaseT],
    method: Method[CaseT],
    setting: Setting,
    case: CaseT,
    direct: FloatArray,
    reference: FloatArray,
    seconds: float,
    electrons: float,
) -> dict[str, Any]:
    """Return {column: value}: the object, CPU seconds, errors against the standard and direct optics, chance."""
    about = {"method": method.name} | case.about() | {"snr": significance(direct, case, setting)}
    try:
        image, cost, drawn = measure_case(method, setting, case, seconds, electrons)
    except GalSimError:  # its transform would not fit into memory
        image = np.full_like(direct, np.nan)
        cost = np.nan
        drawn = 0
    errors = {}
    if drawn:
        for name, expected in (("standard", reference), ("direct", direct)):
            errors[name], by_chance = bench.errors(setting, case, image, expected, drawn)
        errors["chance"] = by_chance
    unknown = np.full(len(bench.names), np.nan)
    columns = {
        f"{name}_{which}": value
        for which in ("standard", "direct", "chance")
        for name, value in zip(bench.names, errors.get(which, unknown), strict=True)
    }
    return about | {"cpu_s": cost, "drawn": drawn} | columns


def measure_case(method: Method[CaseT], setting: Setting, case: CaseT, seconds: float, electrons: float) -> Measured:
    """Return the image, cost and electrons drawn of a method for a case; arguments as in `sweep`."""
    per_copy = min(case.electrons, method.electrons_max)
    draw = method.prepare(setting, case.brighter(per_copy))
    copies = 1
    image, cpu_s = _timed(draw, copies)
    if cpu_s < SLOW:  # the first draw also fills caches
        image, cpu_s = _timed(draw, 1)
    random = method.random or image.dtype.kind == "i"
    while cpu_s < seconds:
        copies *= int(np.ceil(np.clip(1.2 * seconds / max(cpu_s, 1e-9), 2, 10)))
        image, cpu_s = _timed(draw, copies)
    copies_needed = min(electrons / per_copy, TOO_LONG * seconds / cpu_s * copies) if random else 0
    if copies_needed > copies:
        copies = int(np.ceil(copies_needed))
        image, cpu_s = _timed(draw, copies)
    drawn = copies * per_copy if random else np.inf
    cost = cpu_s / copies * case.electrons / per_copy
    return Measured(image / (copies * per_copy), cost, drawn)


def _timed(draw: Draw, copies: int) -> tuple[AnyArray, float]:
    start = time.process_time()
    image = draw(copies)
    return image, time.process_time() - start


def significance(light: FloatArray, case: Case, setting: Setting) -> float:
    """Return the S/N of an object in an ideal filter, including its own photon noise.

    light (ny, nx): of the object, per unit of flux.
    """
    light = case.electrons * np.maximum(light, 0)
    return float(np.sqrt((light**2 / (light + setting.variance)).sum()))
