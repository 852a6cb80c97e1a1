"""Cards of a FITS header: a keyword with its value and comment, or a remark (FITS standard 4.0, section 4)."""

import math

import numpy as np


def card(keyword, value, comment=""):
    """Return the 80 characters of a header card; a string too long for one card continues in CONTINUE cards.

    A comment that does not fit is cut; characters outside ASCII are written as escapes. Raises ValueError for
    a keyword, number or type that FITS cannot hold.
    """
    if not (0 < len(keyword) <= 8 and all(c.isascii() and (c.isupper() or c.isdigit() or c in "-_") for c in keyword)):
        raise ValueError(f"not a FITS keyword: {keyword!r}")
    tail = f" / {_ascii(comment)}" if comment else ""
    if isinstance(value, bool | np.bool_):
        text = f"{'T' if value else 'F':>20}"
    elif isinstance(value, int | np.integer):
        text = f"{int(value):>20}"
    elif isinstance(value, float | np.floating) and math.isfinite(value):
        text = f"{float(value)!r:>20}".upper()
    elif isinstance(value, str):
        return _string_card(keyword, _ascii(value).replace("'", "''"), tail)
    else:
        raise ValueError(f"{keyword}: a FITS card cannot hold {value!r}")
    return f"{keyword:<8}= {text}{tail}"[:80].ljust(80)


def _string_card(keyword, text, tail):
    if len(text) <= 68:
        quoted = f"'{text:<8}'"
        return f"{keyword:<8}= {quoted:<20}{tail}"[:80].ljust(80)
    lines, lead = [], f"{keyword:<8}= "
    while len(text) > 67:
        cut = 67 - (text[:67].count("'") % 2)  # a doubled quote stays on one card
        lines.append(f"{lead}'{text[:cut]}&'".ljust(80))
        text, lead = text[cut:], "CONTINUE  "
    return "".join([*lines, f"{lead}'{text}'{tail}"[:80].ljust(80)])


def remark(keyword, text=""):
    """Return COMMENT, HISTORY or blank cards for a text of any length."""
    text = _ascii(text)
    return "".join(f"{keyword:<8}{text[i : i + 72]}".ljust(80) for i in range(0, max(len(text), 1), 72))


def _ascii(text):
    text = str(text).encode("ascii", "backslashreplace").decode()
    return "".join(c if 32 <= ord(c) < 127 else " " for c in text)
