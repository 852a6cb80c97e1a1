"""aXe's configuration files of gratings, as extraction software reads them (Kuemmel et al. 2009, PASP 121, 59).

    BEAMA 719 1216            extent of the order along x, from the direct image [px]
    DYDX_ORDER_A 1            y = YOFF + DYDX_A_0 + DYDX_A_1 (x - XOFF), x and y from the direct image
    DISP_ORDER_A 1            lambda = DLDP_A_0 + DLDP_A_1 L [angstrom], L [px] along the trace from x = XOFF
    XOFF_A, YOFF_A            [px]
    SENSITIVITY_A GI_p1.fits  table of WAVELENGTH [A] and SENSITIVITY [e-/s/A per erg/s/cm2/A], next to the .conf

Each coefficient has one, three or six numbers, the factors of 1, m, n, m^2, m n, n^2 of the direct image's 0-based
pixel m, n. Beams A to E are the orders +1, 0, +2, -1, -2. Comments begin with `;` or `#`.

The paper's L (equation 2) is the distance from the reference point; aXe's L is signed and measured along the trace.
Their absolute values are equal for a0 = 0, and otherwise differ by a0^2 / 2L (1e-3 px).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from typing import Any

    from csstsim.base.types import FloatArray, Floats, PathLike

BEAMS = {"A": 1, "B": 0, "C": 2, "D": -1, "E": -2}
TERMS = ("1", "m", "n", "m^2", "m n", "n^2")
COEFFICIENTS = {
    "xoff": "XOFF_{}",
    "yoff": "YOFF_{}",
    "a0": "DYDX_{}_0",
    "a1": "DYDX_{}_1",
    "alpha0": "DLDP_{}_0",
    "alpha1": "DLDP_{}_1",
}
# smaller coefficients are rounding errors of a fit: they contribute less than 1e-9 on a chip
_ROUNDING = np.array([1e-9, 1e-13, 1e-13, 1e-17, 1e-17, 1e-17])


def field_terms(m: Floats, n: Floats) -> FloatArray:
    """Return the terms (..., 6) of a coefficient at pixels m, n (broadcast to the shape ...), in aXe's order."""
    m, n = np.broadcast_arrays(np.asarray(m, float), np.asarray(n, float))
    return np.stack([np.ones_like(m), m, n, m * m, m * n, n * n], axis=-1)


def field_range(coefficient: FloatArray, x0: float, x1: float, y0: float, y1: float) -> tuple[float, float]:
    """Return the exact (minimum, maximum) of a coefficient (6,) over direct images x0..x1, y0..y1 [px]."""
    _, b, c, d, e, f = coefficient
    with np.errstate(divide="ignore", invalid="ignore"):
        low = -(b + e * np.array([y0, y1])) / (2 * d)
        high = -(c + e * np.array([x0, x1])) / (2 * f)
        inner = np.array([e * c - 2 * f * b, e * b - 2 * d * c]) / (4 * d * f - e * e)
    # Corners, and stationary points of the edges and of the interior; clipping points outside has no effect
    m = np.nan_to_num(np.array([x0, x1, x0, x1, *low, x0, x1, inner[0]])).clip(x0, x1)
    n = np.nan_to_num(np.array([y0, y0, y1, y1, y0, y1, *high, inner[1]])).clip(y0, y1)
    values = field_terms(m, n) @ coefficient
    return float(values.min()), float(values.max())


def read_axe(path: PathLike) -> dict[int, dict[str, Any]]:
    """Return {order: {"extent": (first, last), "sensitivity": file, coefficient: (6,) array}} of a .conf file.

    Other beams and keys are ignored. Raises InputError for an unreadable file, an incomplete beam, a key that is given
    twice, or a trace that is not a straight line.
    """
    path = Path(path)
    entries: dict[str, list[list[str]]] = {}
    for line in read_text(path).splitlines():
        key, *values = line.split(";")[0].split("#")[0].split() or [""]
        if key.startswith("BEAM_"):
            raise InputError("a beam of grismconf, not of aXe", file=path, key=key, allowed="BEAMA to BEAME")
        entries.setdefault(key, []).append(values)
    for key in ("XOFF", "YOFF", "REFX", "REFY"):
        if key in entries and _numbers(entries, key, (1,), path)[0] != 0:
            raise InputError("pixels must count from the chip's corner", file=path, key=key, allowed="0, or left out")
    if "BEAMA" not in entries:
        raise InputError("the first order is missing", file=path, key="BEAMA")
    return {order: _beam(entries, beam, path) for beam, order in BEAMS.items() if f"BEAM{beam}" in entries}


def _words(entries: Mapping[str, list[list[str]]], key: str, path: Path) -> list[str]:
    given = entries.get(key, [])
    if len(given) > 1:
        raise InputError("given twice", file=path, key=key, value=[" ".join(words) for words in given])
    if not given or not given[0]:
        raise InputError("required key is missing", file=path, key=key)
    return given[0]


def _numbers(entries: Mapping[str, list[list[str]]], key: str, counts: Sequence[int], path: Path) -> FloatArray:
    words = _words(entries, key, path)
    try:
        values = np.array(words, dtype=float)
    except ValueError:
        raise InputError("must be numbers", file=path, key=key, value=" ".join(words)) from None
    if len(values) not in counts or not np.isfinite(values).all():
        allowed = f"{' or '.join(map(str, counts))} finite numbers"
        raise InputError("cannot be used", file=path, key=key, value=values.tolist(), allowed=allowed)
    return values


def _beam(entries: Mapping[str, list[list[str]]], beam: str, path: Path) -> dict[str, Any]:
    degrees = {key: _numbers(entries, key, (1,), path)[0] for key in (f"DYDX_ORDER_{beam}", f"DISP_ORDER_{beam}")}
    for (key, degree), allowed in zip(degrees.items(), ((0, 1), (1,)), strict=True):
        if degree not in allowed:
            raise InputError(
                "traces and dispersion are linear here (paper, equations 1 and 2)",
                file=path,
                key=key,
                value=float(degree),
                allowed=" or ".join(map(str, allowed)),
            )
    extent = _numbers(entries, f"BEAM{beam}", (2,), path)
    if not extent[0] < extent[1]:
        raise InputError("must rise", file=path, key=f"BEAM{beam}", value=extent.tolist())
    content: dict[str, Any] = {"extent": tuple(extent.tolist())}
    for name, pattern in COEFFICIENTS.items():
        no_slope = name == "a1" and degrees[f"DYDX_ORDER_{beam}"] == 0
        values = np.zeros(1) if no_slope else _numbers(entries, pattern.format(beam), (1, 3, 6), path)
        content[name] = np.concatenate([values, np.zeros(6 - len(values))])
    if not content["alpha1"].any():
        raise InputError(
            "an order without dispersion: for a very small dispersion give many angstrom per pixel",
            file=path,
            key=f"DLDP_{beam}_1",
            value=0,
        )
    return content | {"sensitivity": _words(entries, f"SENSITIVITY_{beam}", path)[0]}


def sensitivity_file(stem: str, order: int) -> str:
    """Return the name of an order's sensitivity file: STEM_p1.fits, STEM_m2.fits."""
    return f"{stem}_{'m' if order < 0 else 'p'}{abs(order)}.fits"


def axe_text(orders: Mapping[int, Mapping[str, Any]], comments: Iterable[str] = ()) -> str:
    """Return the text of a .conf file; `orders` as returned by `read_axe`, each coefficient (6,)."""
    lines = [f"# {line}" for line in comments]
    for beam, number in BEAMS.items():
        if number not in orders:
            continue
        order = orders[number]
        lines += ["", f"# Order {number:+d}", "BEAM{} {:.0f} {:.0f}".format(beam, *order["extent"])]
        lines += [f"DYDX_ORDER_{beam} 1", f"DISP_ORDER_{beam} 1"]
        for name, pattern in COEFFICIENTS.items():
            values = np.trim_zeros(np.where(np.abs(order[name]) > _ROUNDING, order[name], 0.0), "b")
            count = next(k for k in (1, 3, 6) if k >= len(values))
            lines.append(" ".join([pattern.format(beam), *(f"{v:.9g}" for v in order[name][:count])]))
        lines.append(f"SENSITIVITY_{beam} {order['sensitivity']}")
    return "\n".join(lines) + "\n"
