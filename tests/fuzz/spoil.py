"""Hypothesis strategies that make the bytes of a hostile file from those of a sound one.

Positions are drawn as integers and taken modulo the number available, so that hypothesis can shrink them.
"""

import numpy as np
from hypothesis import strategies as st

from csstsim.io.fits_checksum import BLOCK, encoded, folded, sum_of_bytes

CARD = 80
PLACE = st.integers(0, 2**24)
NUMBERS = [
    "0", "-1", "1", "3", "61", "0.5", "1e-320", "1e308", "1e999", "nan", "inf", "-inf", "9223372036854775808",
    "-9223372036854775808", "1000000000000",
]  # fmt: skip
WORDS = ["", '"', "''", "true", "null", "[]", "{}", "[[1]]", "../../escaped", "/dev/zero", "%s{0}", "café", "1:30", "@"]
YAML = ["!!python/name:os.system", "!!binary AAAA", "!!timestamp 2027-13-45", "&a [*a]", "*nothing", "<<: *nothing"]
CARDS = ["T", "F", "(1.0, 2.0)", "'RICE_1'", "'BINTABLE'", "'1000000 x 1000000'", "'0 x 0'", "'unclosed"]
KEYWORDS = [
    "NAXIS", "NAXIS1", "NAXIS2", "NAXIS999", "BITPIX", "PCOUNT", "GCOUNT", "TFIELDS", "ZNAXIS1", "ZCMPTYPE", "ZTILE1",
    "EXTNAME", "BZERO", "END",
]  # fmt: skip


def spoiled_bytes(sound):
    """Bytes changed, cut, grown, doubled or made zero."""
    change = st.tuples(st.sampled_from(("flip", "cut", "grow", "zero", "double", "put")), PLACE, st.binary(max_size=40))
    return st.lists(change, min_size=1, max_size=4).map(lambda changes: _apply_bytes(sound, changes))


def _apply_bytes(data, changes):
    data = bytearray(data)
    for kind, place, extra in changes:
        at = place % (len(data) + 1)
        if kind == "flip" and data:
            data[at % len(data)] ^= 1 + place % 255
        elif kind == "cut":
            del data[at:]
        elif kind == "grow":
            data += extra * (1 + place % 100)
        elif kind == "zero":
            data[at : at + 64] = bytes(len(data[at : at + 64]))
        elif kind == "double":
            data[at:at] = data[at : at + 500]
        else:
            data[at:at] = extra
    return bytes(data)


def spoiled_text(sound):
    """YAML, JSON or a table with words that do not belong, lines doubled or lost; or spoiled bytes."""
    odd = st.sampled_from([*NUMBERS, *WORDS, *YAML, "x" * 5000, "[" * 150 + "]" * 150])
    change = st.tuples(st.sampled_from(("word", "word", "word", "line", "drop", "double")), PLACE, odd)
    return st.lists(change, min_size=1, max_size=3).map(lambda c: _apply_text(sound.decode(), c)) | spoiled_bytes(sound)


def _apply_text(text, changes):
    lines = text.splitlines()
    for kind, place, piece in changes:
        at = place % max(len(lines), 1)
        if kind == "word" and lines:
            mark = next((mark for mark in (": ", ",") if mark in lines[at]), " ")
            parts = lines[at].split(mark)
            parts[place // 7 % len(parts)] = piece
            lines[at] = mark.join(parts)
        elif kind == "drop":
            del lines[at : at + 1]
        else:
            lines.insert(at, lines[at] if kind == "double" and lines else piece)
    return "\n".join(lines).encode()


def spoiled_fits(sound):
    """FITS with cards that lie, are doubled or lost; half of them with checksums that are right again."""
    kinds = st.sampled_from(("value", "value", "value", "keyword", "drop", "double"))
    change = st.tuples(kinds, PLACE, st.sampled_from(NUMBERS + CARDS), st.sampled_from(KEYWORDS))
    cards = st.tuples(st.lists(change, min_size=1, max_size=3), st.booleans())
    return cards.map(lambda drawn: _apply_fits(sound, *drawn)) | spoiled_bytes(sound)


def _apply_fits(data, changes, sealed):
    data = bytearray(data)
    hdus = headers(data)
    for kind, place, value, keyword in changes:
        cards = _cards(data)
        named = [c for c in cards if c[1].strip() == keyword.encode()] if place % 2 else cards
        start, _ = (named or cards)[place // 2 % len(named or cards)]
        card = bytes(data[start : start + CARD])
        if kind == "double":
            start = cards[place // 7 % len(cards)][0]
        new = {
            "value": card[:10] + value.rjust(20).encode(),
            "keyword": keyword.ljust(8).encode() + card[8:],
            "drop": b"",
        }
        data[start : start + CARD] = new.get(kind, card)[:CARD].ljust(CARD)
    return bytes(seal(data, hdus) if sealed else data)


def _cards(data):
    """Return where cards stand: (start, keyword) of each."""
    cards = ((start, bytes(data[start : start + 8])) for start in range(0, len(data) - CARD + 1, CARD))
    return [(at, key) for at, key in cards if data[at + 8 : at + 10] == b"= " and key.strip().isascii() and key.strip()]


def headers(data):
    """Return (start, stop) of each HDU of a sound file."""
    starts = [at for at in range(0, len(data), BLOCK) if data[at : at + 8] in (b"SIMPLE  ", b"XTENSION")]
    return list(zip(starts, [*starts[1:], len(data)], strict=True))


def seal(data, hdus):
    """Return the data with every CHECKSUM made right; the HDUs lie as they did before."""
    for start, stop in hdus:
        at = bytes(data[:stop]).find(b"CHECKSUM= '", start)
        if at < 0:
            continue
        data[at + 11 : at + 27] = b"0" * 16
        total = folded(sum_of_bytes(np.frombuffer(bytes(data[start:stop]), np.uint8)))
        data[at + 11 : at + 27] = encoded(0xFFFFFFFF - total).encode()
    return data
