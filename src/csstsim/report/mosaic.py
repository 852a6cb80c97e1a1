"""The report's focal plane: thumbnails of an exposure's chips at their positions, with pan and zoom (report.js).

One SVG drawing holds the outlines of all chips and one group per exposure. Its unit is a pixel of the mosaic, with y
down. Chips are placed to a pixel in the mosaic; field distortion is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from csstsim.base.arrays.bounds import bounds_of
from csstsim.base.sphere import rotation
from csstsim.optics.geometry.wcs import mosaic_cd
from csstsim.report.parts import data_url
from csstsim.report.pictures import photograph
from csstsim.report.style import BLACK, GREY
from csstsim.report.thumbnail import MAX_SIDE, binned, brightest_window, step_for, stretch

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from typing import Any

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.instrument.chip import Chip, Window
    from csstsim.io.level0 import Level0
    from csstsim.report.style import BandStyle

BRIGHTER = {BLACK: "#FFFFFF", GREY: "#888888"}  # brighter than in the figures, to show on black
BUTTONS = (
    ("in", "+", "zoom in (key +)"),
    ("out", "\u2212", "zoom out (key -)"),
    ("reset", "focal plane", "all chips (key 0)"),
    ("exposure", "exposure", "the simulated chips (key 1)"),
    ("detail", "full resolution", "the cutout (key 2)"),
)

Shape: TypeAlias = dict[str, str | int]  # what templates/focal_plane.html draws


@dataclass(frozen=True)
class Picture:
    """An image (WebP) of the `window` (instrument.chip.Window) of `chip`, in blocks of `step` x `step` pixels."""

    chip: Chip
    window: Window
    step: int
    image: bytes


@dataclass(frozen=True)
class Exposure:
    """Pictures of an exposure's chips, and one at full resolution (or None)."""

    title: str
    pa: float  # deg
    pictures: tuple[Picture, ...]
    detail: Picture | None


def take_exposure(
    title: str,
    pa: float,
    files: Iterable[tuple[Chip, Level0]],
    max_side: int = MAX_SIDE,
    choose_cutout: Callable[[Chip, Level0, int], Window | None] | None = None,
) -> Exposure:
    """Return the Exposure of `files`, (Chip, open io.level0.Level0) each; pictures have at most `max_side` px a side.

    choose_cutout(chip, file, max_side): the Window to show at full resolution, or None: then the brightest one.
    """
    pictures: list[Picture] = []
    best: tuple[tuple[bool, float], tuple[Chip, Level0, IntArray, int] | None] = ((False, -1.0), None)
    for chip, file in files:
        step = step_for(file.window, max_side)
        greys = stretch(binned(file, file.window, step))
        pictures.append(Picture(chip, file.window, step, photograph(greys)))
        rank = chip.kind == "imaging", float(greys.std())  # images rank before spectra, then by contrast
        if step > 1 and rank > best[0]:
            best = rank, (chip, file, greys, step)
    detail = None
    if best[1]:
        chip, file, greys, step = best[1]
        chosen = choose_cutout and choose_cutout(chip, file, max_side)
        window = chosen or brightest_window(greys, file.window, step, max_side)
        detail = Picture(chip, window, 1, photograph(stretch(binned(file, window, 1))))
    return Exposure(title, pa, tuple(pictures), detail)


class FocalPlane(NamedTuple):
    """The viewer, a part of the page (report.parts); templates/focal_plane.html draws its shapes and groups.

    mirrored: with north up, east is to the right.
    """

    box: str
    outlines: list[Shape]
    labels: list[Shape]
    groups: list[dict[str, Any]]
    mirrored: bool
    buttons: tuple[tuple[str, str, str], ...] = BUTTONS


def mosaic(chips: Sequence[Chip], exposures: Iterable[Exposure], styles: Mapping[str, BandStyle]) -> FocalPlane:
    """Return the FocalPlane.

    `chips`: all chips of the camera; `exposures`: one or more; `styles`: report.style.band_styles of its filters.
    """
    colours = {chip.id: BRIGHTER.get(c := styles[chip.filter.lower()].colour, c) for chip in chips}
    corners = np.concatenate([_corners(chip, chip.full_window) for chip in chips])
    x0, x1, y0, y1 = bounds_of(corners)
    edge = 0.01 * (x1 - x0)
    gap = _gap(chips)
    box = (x0 - edge, y0 - edge - gap, x1 - x0 + 2 * edge, y1 - y0 + 2 * edge + gap)
    outlines = [_outline(chip, chip.full_window, "idle", colours) for chip in chips]
    groups = [_group(exposure, colours) for exposure in exposures]
    mirrored = bool(np.linalg.det(mosaic_cd(0.0, chips[0].telescope)) > 0)
    return FocalPlane(_numbers(box), outlines, [_chip_label(chip, gap) for chip in chips], groups, mirrored)


def _group(exposure: Exposure, colours: Mapping[int, str]) -> dict[str, Any]:
    detail = exposure.detail
    pictures = exposure.pictures
    shapes = [_image(picture) for picture in (*pictures, *([detail] if detail else []))]
    shapes += [_outline(p.chip, p.chip.full_window, "chip", colours) for p in pictures]
    for p in pictures:
        shapes += [_outline(p.chip, p.window, "window", colours), *_window_label(p)]
    shapes += [_outline(detail.chip, detail.window, "cutout", colours)] if detail else []
    box = _box(np.concatenate([_corners(p.chip, p.window) for p in pictures]))
    cutout = _box(_corners(detail.chip, detail.window)) if detail else ""
    return {"title": exposure.title, "box": box, "detail": cutout, "shapes": shapes, "arrows": _compass(exposure)}


def _image(picture: Picture) -> Shape:
    """Return the shape of a picture; blocks at the window's far edges may reach beyond it by less than a block."""
    x, bottom = _drawing_position(picture.chip, picture.window.x0, picture.window.y0)
    width, height = (-(-n // picture.step) * picture.step for n in (picture.window.nx, picture.window.ny))
    return {
        "kind": "image",
        "url": data_url(picture.image),
        "x": f"{x:g}",
        "y": f"{bottom - height:g}",
        "width": width,
        "height": height,
        "turn": _turn(picture.chip),
    }


def _outline(chip: Chip, window: Window, style: str, colours: Mapping[int, str]) -> Shape:
    x, y = _drawing_position(chip, window.x0, window.y1)
    return {
        "kind": "outline",
        "style": style,
        "colour": colours[chip.id],
        "x": f"{x:g}",
        "y": f"{y:g}",
        "width": window.nx,
        "height": window.ny,
        "turn": _turn(chip),
    }


def _chip_label(chip: Chip, gap: float) -> Shape:
    """Label a chip in the gap above it, off its pixels; gap: px."""
    return _label(chip, *_drawing_position(chip, 0, chip.detector.ny), 0.8 * gap)


def _gap(chips: Sequence[Chip]) -> float:
    """Return the height [px] of the gap between rows of chips; a single row has free space above."""
    rows = sorted({chip.yc for chip in chips})
    max_gap = 0.15 * min(chips[0].detector.nx, chips[0].detector.ny)
    return max(min([max_gap, *(b - a - chips[0].detector.ny for a, b in pairwise(rows))]), 0.02 * max_gap)


def _window_label(picture: Picture) -> list[Shape]:
    """Label a window much smaller than its chip: the chip's own label may then be far off or out of view."""
    window = picture.window
    if 2 * max(window.shape) > max(picture.chip.detector.nx, picture.chip.detector.ny):
        return []
    return [_label(picture.chip, *_drawing_position(picture.chip, window.x0, window.y1), 0.05 * min(window.shape))]


def _label(chip: Chip, x: float, y: float, size: float) -> Shape:
    """Return the shape of a chip's name above x, y."""
    name = f"{chip.label} {chip.filter}"
    where = {"x": f"{x:g}", "y": f"{y - 0.2 * size:g}", "size": f"{size:g}", "turn": _turn(chip)}
    return {"kind": "label", "text": name, **where}


def _compass(exposure: Exposure) -> list[tuple[str, ...]]:
    """Return (name, angle [deg], x, y) of the arrows towards north and east; they do not zoom."""
    inverse = np.linalg.inv(mosaic_cd(exposure.pa, exposure.pictures[0].chip.telescope))
    angles = [math.atan2(-dy, dx) for dx, dy in inverse.T]  # columns: mosaic pixels per degree east, north
    return [
        (name, *(f"{v:.2f}" for v in (math.degrees(angle), 40 * math.cos(angle), 40 * math.sin(angle))))
        for name, angle in zip("EN", angles, strict=True)
    ]


def _drawing_position(chip: Chip, x: float, y: float) -> tuple[float, float]:
    """Return the position of a chip's pixel corner (x, y) in the drawing, before the chip's rotation."""
    return chip.xc - chip.detector.nx / 2 + x, -(chip.yc - chip.detector.ny / 2 + y)


def _turn(chip: Chip) -> str:
    return f"rotate({-chip.rotation:g} {chip.xc:g} {-chip.yc:g})" if chip.rotation else ""


def _corners(chip: Chip, window: Window) -> FloatArray:
    """Return the corners (4, 2) of a window in the drawing."""
    positions = [_drawing_position(chip, x, y) for x in (window.x0, window.x1) for y in (window.y0, window.y1)]
    centre = np.array([chip.xc, -chip.yc])
    return (np.array(positions) - centre) @ rotation(math.radians(-chip.rotation)).T + centre


def _box(corners: FloatArray) -> str:
    x0, x1, y0, y1 = bounds_of(corners)
    return _numbers((x0, y0, x1 - x0, y1 - y0))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.1f}" for value in values)
