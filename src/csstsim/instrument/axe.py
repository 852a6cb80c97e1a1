"""aXe's configuration files of gratings, as extraction software reads them (Kuemmel et al. 2009, PASP 121, 59).

    BEAMA 719 1216            extent of the order along x, from the direct image [px]
    DYDX_ORDER_A 1            y = YOFF + DYDX_A_0 + DYDX_A_1 (x - XOFF), x and y from the direct image
    DISP_ORDER_A 1            lambda = DLDP_A_0 + DLDP_A_1 L [angstrom], L [px] along the trace from x = XOFF
    XOFF_A, YOFF_A            [px]
    SENSITIVITY_A GI_p1.fits  table of WAVELENGTH [A] and SENSITIVITY [e-/s/A per erg/s/cm2/A], beside the .conf

Each coefficient has one number, three, or six, of the direct image's 0-based pixel m, n: 1, m, n, m^2, m n, n^2. Beams
A to E are the orders +1, 0, +2, -1, -2. `;` and `#` begin comments.

The paper's L (equation 2) is the distance from the reference point; aXe's follows the trace and has a sign: the same
number where a0 = 0, and to a0^2 / 2L (1e-3 px) otherwise.
"""

from pathlib import Path

import numpy as np

from csstsim.errors import InputError

BEAMS = {"A": 1, "B": 0, "C": 2, "D": -1, "E": -2}
TERMS = ("1", "m", "n", "m^2", "m n", "n^2")
COEFFICIENTS = {"xoff": "XOFF_{}", "yoff": "YOFF_{}", "a0": "DYDX_{}_0", "a1": "DYDX_{}_1", "alpha0": "DLDP_{}_0",
                "alpha1": "DLDP_{}_1"}  # fmt: skip
_NOTHING = np.array([1e-9, 1e-13, 1e-13, 1e-17, 1e-17, 1e-17])  # rounding of a fit: 1e-9 of a coefficient on a chip


def field_terms(m, n):
    """Return (..., 6): the terms of a coefficient at pixels m, n, in aXe's order."""
    m, n = np.broadcast_arrays(np.asarray(m, float), np.asarray(n, float))
    return np.stack([np.ones_like(m), m, n, m * m, m * n, n * n], axis=-1)


def read_axe(path):
    """Return {order: {"extent": (first, last), "sensitivity": file, coefficient: (6,) array}} of a .conf file.

    Raises InputError for an unreadable file, a beam that is not described in full, or one that is no straight line.
    """
    path = Path(path)
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as exc:
        raise InputError(f"cannot be read: {exc}", file=path) from None
    entries = {}
    for line in lines:
        key, *values = line.split(";")[0].split("#")[0].split() or [""]
        if key in entries:
            raise InputError("given twice", file=path, key=key)
        if key:
            entries[key] = values
    orders = {order: _beam(entries, beam, path) for beam, order in BEAMS.items() if f"BEAM{beam}" in entries}
    if 1 not in orders:
        raise InputError("the first order is missing", file=path, key="BEAMA")
    return orders


def _beam(entries, beam, path):
    def numbers(key, counts):
        values = entries.get(key)
        if values is None:
            raise InputError("required key is missing", file=path, key=key)
        try:
            values = np.array(values, dtype=float)
        except ValueError:
            raise InputError("must be numbers", file=path, key=key, value=" ".join(values)) from None
        if len(values) not in counts or not np.isfinite(values).all():
            raise InputError("must be finite", file=path, key=key, value=values.tolist(), allowed=f"{counts} numbers")
        return values

    for key in (f"DYDX_ORDER_{beam}", f"DISP_ORDER_{beam}"):
        if numbers(key, (1,))[0] != 1:
            raise InputError("traces and dispersion are linear here (paper, equations 1 and 2)", file=path, key=key,
                             value=entries[key][0], allowed="1")  # fmt: skip
    extent = numbers(f"BEAM{beam}", (2,))
    if not extent[0] < extent[1]:
        raise InputError("must rise", file=path, key=f"BEAM{beam}", value=extent.tolist())
    found = {"extent": tuple(extent.tolist())}
    for name, pattern in COEFFICIENTS.items():
        values = numbers(pattern.format(beam), (1, 3, 6))
        found[name] = np.concatenate([values, np.zeros(6 - len(values))])
    if not found["alpha1"].any():
        raise InputError("no dispersion at all: give it a tiny one", file=path, key=f"DLDP_{beam}_1", value=0)
    sensitivity = entries.get(f"SENSITIVITY_{beam}")
    if not sensitivity:
        raise InputError("required key is missing", file=path, key=f"SENSITIVITY_{beam}")
    return found | {"sensitivity": sensitivity[0]}


def axe_text(orders, comments=()):
    """Return the text of a .conf file; `orders` as `read_axe` gives them."""
    lines = [f"# {line}" for line in comments]
    for beam, order in BEAMS.items():
        if order not in orders:
            continue
        one = orders[order]
        lines += ["", f"# Order {order:+d}", "BEAM{} {:.0f} {:.0f}".format(beam, *one["extent"])]
        lines += [f"DYDX_ORDER_{beam} 1", f"DISP_ORDER_{beam} 1"]
        for name, pattern in COEFFICIENTS.items():
            values = np.trim_zeros(np.where(np.abs(one[name]) > _NOTHING, one[name], 0.0), "b")
            count = next(k for k in (1, 3, 6) if k >= len(values))
            lines.append(" ".join([pattern.format(beam), *(f"{v:.9g}" for v in one[name][:count])]))
        lines.append(f"SENSITIVITY_{beam} {one['sensitivity']}")
    return "\n".join(lines) + "\n"
