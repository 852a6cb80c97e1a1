"""Run every method on every case: its cost and its error, one row each.

A `Bench` holds what differs between imaging and dispersed light: objects, methods, truth and measures.
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

SLOW = 1.0  # CPU seconds of one object; its set-up is then negligible
TOO_LONG = 5.0  # times the wanted CPU seconds; after that no more electrons are drawn
CaseT = TypeVar("CaseT", bound="Case")
Draw: TypeAlias = Callable[[int], AnyArray]  # of so many copies of an object: the image [electron]


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
        mine = (case for case in cases if case.about()["kind"] == kind)
        faintest = min(mine, key=lambda case: case.electrons)
        for method in methods:
            measured(method, setting, faintest.brighter(2000.0), 0.0, 0.0)
            measured(method, setting, faintest, 0.0, 0.0)
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
        image, cost, drawn = measured(method, setting, case, seconds, electrons)
    except GalSimError:  # its transform would not fit into memory
        image = np.full_like(direct, np.nan)
        cost = np.nan
        drawn = 0
    found = {}
    if drawn:
        for name, wanted in (("standard", reference), ("direct", direct)):
            found[name], chance = bench.errors(setting, case, image, wanted, drawn)
        found["chance"] = chance
    nothing = np.full(len(bench.names), np.nan)
    columns = {
        f"{name}_{which}": value
        for which in ("standard", "direct", "chance")
        for name, value in zip(bench.names, found.get(which, nothing), strict=True)
    }
    return about | {"cpu_s": cost, "drawn": drawn} | columns


def measured(method: Method[CaseT], setting: Setting, case: CaseT, seconds: float, electrons: float) -> Measured:
    """Return what a method Measured of a case, as `sweep` does."""
    used = min(case.electrons, method.most)
    draw = method.prepare(setting, case.brighter(used))
    copies = 1
    image, took = _timed(draw, copies)
    if took < SLOW:  # the first draw also fills caches
        image, took = _timed(draw, 1)
    random = method.random or image.dtype.kind == "i"
    while took < seconds:
        copies *= int(np.ceil(np.clip(1.2 * seconds / max(took, 1e-9), 2, 10)))
        image, took = _timed(draw, copies)
    enough = min(electrons / used, TOO_LONG * seconds / took * copies) if random else 0
    if enough > copies:
        copies = int(np.ceil(enough))
        image, took = _timed(draw, copies)
    drawn = copies * used if random else np.inf
    return Measured(image / (copies * used), took / copies * case.electrons / used, drawn)


def _timed(draw: Draw, copies: int) -> tuple[AnyArray, float]:
    start = time.process_time()
    image = draw(copies)
    return image, time.process_time() - start


def significance(light: FloatArray, case: Case, setting: Setting) -> float:
    """Return the S/N of an object in an ideal filter, including the noise of its own light."""
    light = case.electrons * np.maximum(light, 0)
    return float(np.sqrt((light**2 / (light + setting.variance)).sum()))
