"""Write Level-0 files (io.level0 describes them): keywords of level0_keywords.yaml, world coordinates, pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.types import PathLike
from csstsim.detector.channels import Block, ReadoutFrame
from csstsim.detector.mask import BITS
from csstsim.io.fits_writing import card, compress, remark, write_hdus
from csstsim.io.keywords import header_cards, header_values
from csstsim.optics.geometry.sip import sip_header

if TYPE_CHECKING:
    from csstsim.optics.geometry.wcs import ChipWCS
    from csstsim.simulation.state import State


def write_level0(
    path: PathLike,
    state: State,
    keywords: Sequence[Any],
    provenance: Mapping[str, Any],
    layout: str | None = None,
) -> None:
    """Write the Level-0 file of a digitised state (uint16 readout frame in state.image).

    keywords: the header table (Camera.keywords); provenance: as for `io.keywords.header_values`; layout: by default
    that of quantization_and_output. Raises ValueError for an image that is not a uint16 readout frame.
    """
    layout = layout or state.header.get("layout", "channels")
    frame = ReadoutFrame.of(state.chip.detector, state.window)
    if state.image.dtype != np.uint16:
        raise ValueError(f"Level-0 holds uint16; the image is {state.image.dtype}: quantization_and_output is missing")
    primary, image = level0_cards(state, keywords, provenance, layout)
    hdus = [("", primary, None), ("IMAGE", image, frame.to_stored(state.image, layout))]
    if state.mask is not None:
        hdus.append(("MASK", mask_cards(), frame.to_stored(state.mask, layout)))
    with atomic_path(path) as temporary:
        write_hdus(temporary, hdus)
        if state.header.get("compress"):
            compress(temporary)


def level0_cards(
    state: State, keywords: Sequence[Any], provenance: Mapping[str, Any], layout: str
) -> tuple[list[str], list[str]]:
    """Return the cards of HDU 0 and of IMAGE, two lists; arguments as of `write_level0`."""
    frame = ReadoutFrame.of(state.chip.detector, state.window).of_file(layout)
    values = header_values(state, provenance, layout)
    image = header_cards(keywords, values, 1) + wcs_cards(state.wcs, frame, layout, state.header.get("sip"))
    return header_cards(keywords, values, 0), image


def mask_cards() -> list[str]:
    """Return the cards with the meaning of the bits of MASK."""
    return [card(f"BIT{value.bit_length() - 1}", name, f"value {value}") for name, value in BITS.items()]


def wcs_cards(wcs: ChipWCS, frame: ReadoutFrame, layout: str, sip: bool | None = False) -> list[str]:
    """Return the cards of the assembled frame's WCS and of one alternate WCS per channel.

    In a channel's block, chip x = x0 + sx X with sx = +-1 (mirroring). So CRPIX' = sx (CRPIX - x0) in 0-based pixels,
    and the CD columns change sign. With `sip` the assembled frame's WCS has the field distortion, and there are no
    alternates, because readers (astropy) would apply the polynomials to those, too. Layout `chip` needs none: the
    stored array is the assembled frame.
    """
    full_frame = ReadoutFrame.of(frame, None)
    relation = "which is the stored array" if layout == "chip" else "not of the stored array"
    cards = [remark("COMMENT", f" WCS of the assembled active frame (DETSIZE), {relation}")]
    cards += [
        remark("COMMENT", " Its directions are apparent: aberration and light deflection at the spacecraft"),
        remark("COMMENT", " (EXPSTART, POSI0_*, VELO0_* of the primary header) are in them; axes as ICRS"),
    ]
    if sip and wcs.distortion:
        cards.append(remark("COMMENT", " Field distortion is in this WCS, as SIP polynomials"))
        with_distortion = sip_header(wcs) | {"WCSNAME": "assembled frame"}
        return cards + [card(key, value) for key, value in with_distortion.items()]
    if wcs.distortion:
        cards.append(remark("COMMENT", " Field distortion is in the image, but not in this linear WCS"))
    linear = wcs.header()
    cards += [card(key, value) for key, value in linear.items()] + [card("WCSNAME", "assembled frame")]
    for block in full_frame.blocks if layout != "chip" else ():
        cards.append(remark("COMMENT", f" WCS {_letter(block)}: the stored pixels of channel {block.channel}"))
        cards += [
            card(key + _letter(block), value) for key, value in channel_wcs(linear, full_frame, block, layout).items()
        ]
        cards.append(card("WCSNAME" + _letter(block), f"channel {block.channel}"))
    return cards


def _letter(block: Block) -> str:
    return chr(ord("A") + block.channel - 1)


def channel_wcs(wcs: Mapping[str, Any], frame: ReadoutFrame, block: Block, layout: str) -> dict[str, Any]:
    """Return the chip's WCS {keyword: value} in the stored pixels of one channel."""
    changed = dict(wcs)
    for axis, (start, step) in enumerate(frame.stored_axis(block, layout), start=1):
        changed[f"CRPIX{axis}"] = step * (wcs[f"CRPIX{axis}"] - 1 - start) + 1
        for i in (1, 2):
            changed[f"CD{i}_{axis}"] = step * wcs[f"CD{i}_{axis}"]
    return changed
