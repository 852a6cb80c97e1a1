"""The verdict on a campaign: the gates of all its bricks, failing ones first, and how many pass."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from csstsim.base.files.atomic import atomic_path
from csstsim.measure.bricks.validation.gates.record import MIN_SOURCES

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.measure.bricks.validation.gates.record import GateResult

ORDER = (False, None, True)  # failing gates first
NAMES = {True: "pass", False: "fail", None: "not evaluated"}
# Why a gate does not apply to a campaign: there is no other reason
NO_THRESHOLD = "no threshold is given"
TOO_FEW = f"fewer than {MIN_SOURCES} such objects in the field"
NO_BIN = f"no bin of these objects has {MIN_SOURCES}"


def verdict_of_results(results: Iterable[Mapping[str, Any]], others: Iterable[GateResult] = ()) -> dict[str, Any]:
    """Return {passed, counts, gates} of validate_brick results and of gates of no brick, `others`.

    `gates`: each gate with its brick (None: of no brick), first those that fail, then those not evaluated;
    `counts` {"pass": n, "fail": n, "not evaluated": n}; `passed`: False if a gate fails, None if none was evaluated.
    """
    gates = [{"brick": result["brick"], **gate} for result in results for gate in result["gates"]]
    gates += [{"brick": None, **gate} for gate in others]
    return verdict_of_gates(gates)


def verdict_of_gates(gates: Iterable[GateResult]) -> dict[str, Any]:
    """Return {passed, counts, gates} of gates with their bricks; they are sorted, failing ones first."""
    gates = sorted(gates, key=lambda gate: ORDER.index(gate["passed"]))  # stable: bricks and gates keep their order
    counts = count(gates)
    passed = False if counts["fail"] else True if counts["pass"] else None
    return {"passed": passed, "counts": counts, "gates": gates}


def count(gates: Iterable[GateResult]) -> dict[str, int]:
    """Return {"pass": n, "fail": n, "not evaluated": n}."""
    return {name: sum(gate["passed"] is passed for gate in gates) for passed, name in NAMES.items()}


def counts_by_name(gates: Sequence[GateResult]) -> dict[str, dict[str, int]]:
    """Return {gate's name: counts}, those with the most failures first."""
    names = dict.fromkeys(gate["name"] for gate in gates)
    counts = {name: count([gate for gate in gates if gate["name"] == name]) for name in names}
    return dict(sorted(counts.items(), key=lambda item: -item[1]["fail"]))


def write_verdict(path: PathLike, verdict: dict[str, Any], **about: Any) -> None:
    """Write the verdict as JSON, `about` (campaign's name, version) first; numbers that are not finite become null."""
    gates = [{key: _finite(value) for key, value in gate.items()} for gate in verdict["gates"]]
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(about | verdict | {"gates": gates}, indent=1, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def lines(verdict: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines to print: each failing gate in full, the counts by gate, the gates not evaluated, the verdict."""
    for gate in verdict["gates"]:
        if gate["passed"] is False:
            yield f"FAIL {sentence(gate)}"
    names = counts_by_name(verdict["gates"])
    evaluated = {name: counts for name, counts in names.items() if counts["pass"] or counts["fail"]}
    for name, counts in evaluated.items():
        yield f"{'FAIL' if counts['fail'] else 'pass'} {name}: {tally(counts)}"
    if len(evaluated) < len(names):
        yield f"not evaluated: {', '.join(name for name in names if name not in evaluated)}"
    yield headline(verdict)


def headline(verdict: Mapping[str, Any]) -> str:
    """Return the verdict in a sentence."""
    counts = verdict["counts"]
    if verdict["passed"] is None:
        return "No gate could be evaluated: too few sources, or no thresholds."
    evaluated = counts["pass"] + counts["fail"]
    word = "PASS" if verdict["passed"] else "FAIL"
    reasons = dict.fromkeys(reason_not_evaluated(gate) for gate in verdict["gates"] if gate["passed"] is None)
    others = f"; {counts['not evaluated']} could not be evaluated ({'; '.join(reasons)})" if reasons else ""
    return f"{word}: {counts['pass']} of {evaluated} evaluated gates pass{others}."


def sentence(gate: Mapping[str, Any]) -> str:
    """Return a sentence with a gate's brick, exposure, chip and readout channel, its value and its threshold."""
    where = [f"{name} {gate[name]}" for name in ("brick", "exposure", "chip", "channel") if gate.get(name) is not None]
    band = f" in {gate['band']}" if gate.get("band") else ""
    value = _figure(gate.get("value"))
    threshold = _figure(gate.get("threshold"))
    return f"{', '.join(where)}: {gate['name']}{band} is {value} against {threshold}"


def reason_not_evaluated(gate: Mapping[str, Any]) -> str:
    """Return why a gate that was not evaluated does not apply: NO_THRESHOLD, TOO_FEW or NO_BIN."""
    n = gate.get("n")
    if gate.get("threshold") is None:
        return NO_THRESHOLD
    return TOO_FEW if n is not None and n < MIN_SOURCES else NO_BIN


def never_evaluated(gates: Sequence[GateResult]) -> dict[tuple[str, str], dict[str, int]]:
    """Return {(gate's name, reason): {band: largest number of objects}} of the gates that are evaluated nowhere."""
    evaluated = {(gate["name"], gate.get("band")) for gate in gates if gate["passed"] is not None}
    found: dict[tuple[str, str], dict[str, int]] = {}
    for gate in gates:
        if (gate["name"], gate.get("band")) not in evaluated:
            bands = found.setdefault((gate["name"], reason_not_evaluated(gate)), {})
            band = str(gate.get("band"))
            bands[band] = max(bands.get(band, 0), gate.get("n") or 0)
    return found


def tally(counts: Mapping[str, int]) -> str:
    """Return counts as text."""
    return ", ".join(f"{n} {name}" for name, n in counts.items())


def _figure(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
