"""The focal plane of the report: thumbnails of an exposure's chips at their places, with pan and zoom (report.js).

One drawing (SVG) holds the outlines of all chips and, in a group each, the exposures; its unit is a pixel of the
mosaic, y down. A chip's place is right to a pixel: field distortion is not in it.
"""

import math
from dataclasses import dataclass

import numpy as np

from csstsim.optics.geometry.wcs import mosaic_cd
from csstsim.report.markup import data_url, text
from csstsim.report.style import BLACK, GREY
from csstsim.report.thumbnail import MOST, binned, busiest, png, step_for, stretch

BRIGHTER = {BLACK: "#FFFFFF", GREY: "#888888"}  # than in the figures: they would not show on black
BUTTONS = (
    ("in", "+", "zoom in (key +)"),
    ("out", "\u2212", "zoom out (key -)"),
    ("reset", "focal plane", "all chips (key 0)"),
    ("exposure", "exposure", "what was simulated (key 1)"),
    ("detail", "full resolution", "the cutout (key 2)"),
)
HELP = (
    "Simulated pixels of one exposure, each chip above its own background, asinh stretch in units of its noise; mosaic "
    "+x right, +y up. Wheel, drag, pinch, buttons or keys (+, -, 0, 1, 2, arrows) zoom and move. The dashed square is "
    "at full resolution; outlines without pixels are chips that were not simulated."
)


@dataclass(frozen=True)
class Picture:
    """A PNG and the `window` (instrument.chip.Window) of `chip` that it shows, `step` pixels to a block."""

    chip: object
    window: object
    step: int
    png: bytes


@dataclass(frozen=True)
class Exposure:
    """Pictures of an exposure's chips, and one at full resolution (or None)."""

    title: str
    pa: float  # deg
    pictures: tuple
    detail: Picture | None


def take_exposure(title, pa, files, most=MOST):
    """Return the Exposure of `files`: iterable of (Chip, open io.level0.Level0); pictures are `most` pixels wide."""
    pictures, best = [], ((False, -1.0), None)
    for chip, file in files:
        step = step_for(file.window, most)
        greys = stretch(binned(file, file.window, step))
        pictures.append(Picture(chip, file.window, step, png(greys)))
        liveliness = chip.kind == "imaging", float(greys.std())  # an image before spectra
        if step > 1 and liveliness > best[0]:
            best = liveliness, (chip, file, busiest(greys, file.window, step, most))
    detail = None
    if best[1]:
        chip, file, window = best[1]
        detail = Picture(chip, window, 1, png(stretch(binned(file, window, 1))))
    return Exposure(title, pa, tuple(pictures), detail)


def mosaic(chips, exposures, looks):
    """Return the HTML of the viewer.

    `chips` are all of the camera, `exposures` at least one Exposure, `looks` report.style.looks of its filters.
    """
    colours = {chip.id: BRIGHTER.get(c := looks[chip.filter.lower()].colour, c) for chip in chips}
    corners = np.concatenate([_corners(chip, chip.full_window) for chip in chips])
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    edge = 0.01 * (x1 - x0)
    box = (x0 - edge, y0 - edge, x1 - x0 + 2 * edge, y1 - y0 + 2 * edge)
    outlines = "".join(_outline(chip, chip.full_window, "idle", colours) for chip in chips)
    names = "".join(_chip_label(chip) for chip in chips)
    groups = "".join(_group(exposure, number, colours) for number, exposure in enumerate(exposures))
    options = "".join(f'<option value="{n}">{text(e.title)}</option>' for n, e in enumerate(exposures))
    choose = f'<label>exposure <select name="exposure">{options}</select></label>' if len(exposures) > 1 else ""
    buttons = "".join(
        f'<button type="button" data-zoom="{name}" title="{hint}">{sign}</button>' for name, sign, hint in BUTTONS
    )
    title = f"<figcaption>{text(exposures[0].title) + '. ' if len(exposures) == 1 else ''}{HELP}</figcaption>"
    svg = (
        f'<svg class="plane" tabindex="0" role="img" aria-label="Focal plane" viewBox="{_numbers(box)}">'
        f'<g class="view">{outlines}{groups}{names}</g></svg>'
    )
    arrows = "".join(_compass(exposure, number) for number, exposure in enumerate(exposures))
    return (
        f'<figure class="mosaic"><div class="tools">{choose}{buttons}</div><div class="stage">{svg}'
        f'<svg class="compass" viewBox="-50 -50 100 100" aria-hidden="true">{arrows}</svg></div>{title}</figure>'
    )


def _group(exposure, number, colours):
    boxes = np.concatenate([_corners(p.chip, p.window) for p in exposure.pictures])
    detail = exposure.detail
    data = f'data-box="{_box(boxes)}"'
    if detail:
        data += f' data-detail="{_box(_corners(detail.chip, detail.window))}"'
    shown = "".join(_picture(picture) for picture in (*exposure.pictures, *([detail] if detail else [])))
    frames = "".join(_outline(p.chip, p.chip.full_window, "chip", colours) for p in exposure.pictures)
    frames += "".join(_outline(p.chip, p.window, "window", colours) + _window_label(p) for p in exposure.pictures)
    frames += _outline(detail.chip, detail.window, "cutout", colours) if detail else ""
    return f'<g class="exposure" data-number="{number}"{_hidden(number)} {data}>{shown}{frames}</g>'


def _hidden(number):
    return "" if number == 0 else ' style="display:none"'


def _picture(picture):
    """An image element; the blocks at the window's far edges may reach beyond it, by less than a block."""
    x, bottom = _place(picture.chip, picture.window.x0, picture.window.y0)
    width, height = (-(-n // picture.step) * picture.step for n in (picture.window.nx, picture.window.ny))
    return (
        f'<image x="{x:g}" y="{bottom - height:g}" width="{width}" height="{height}" preserveAspectRatio="none"'
        f'{_turn(picture.chip)} href="{data_url(picture.png)}"/>'
    )


def _outline(chip, window, style, colours):
    x, y = _place(chip, window.x0, window.y1)
    box = f'x="{x:g}" y="{y:g}" width="{window.nx}" height="{window.ny}"'
    return f'<rect class="{style}" {box} stroke="{colours[chip.id]}"{_turn(chip)}/>'


def _chip_label(chip):
    x, y = _place(chip, 0, chip.detector.ny)
    return _label(chip, x, y, 0.15 * min(chip.detector.nx, chip.detector.ny))


def _window_label(picture):
    """The chip's name in a window that is much smaller than the chip, whose own is then far off or out of sight."""
    window = picture.window
    if 2 * max(window.shape) > max(picture.chip.detector.nx, picture.chip.detector.ny):
        return ""
    return _label(picture.chip, *_place(picture.chip, window.x0, window.y1), 0.05 * min(window.shape))


def _label(chip, x, y, size):
    name = f"{chip.label} {chip.filter}"
    return f'<text x="{x + 0.25 * size:g}" y="{y + 1.1 * size:g}" font-size="{size:g}"{_turn(chip)}>{text(name)}</text>'


def _compass(exposure, number):
    """Arrows towards north and east, which do not zoom."""
    inverse = np.linalg.inv(mosaic_cd(exposure.pa, exposure.pictures[0].chip.telescope))
    drawn = []
    for name, (dx, dy) in zip("EN", inverse.T, strict=True):  # mosaic pixels a degree east, and north
        angle = math.atan2(-dy, dx)
        x, y = 40 * math.cos(angle), 40 * math.sin(angle)
        drawn.append(
            f'<path d="M0 0H28m-8 -5l8 5l-8 5" transform="rotate({math.degrees(angle):.2f})"/>'
            f'<text x="{x:.2f}" y="{y:.2f}">{name}</text>'
        )
    return f'<g data-number="{number}"{_hidden(number)}>{"".join(drawn)}</g>'


def _place(chip, x, y):
    """Return the drawing's x, y of the pixel corner (x, y) of an unturned chip."""
    return chip.xc - chip.detector.nx / 2 + x, -(chip.yc - chip.detector.ny / 2 + y)


def _turn(chip):
    return f' transform="rotate({-chip.rotation:g} {chip.xc:g} {-chip.yc:g})"' if chip.rotation else ""


def _corners(chip, window):
    """Return the corners (4, 2) of a window as they are drawn."""
    places = [_place(chip, x, y) for x in (window.x0, window.x1) for y in (window.y0, window.y1)]
    angle, centre = math.radians(-chip.rotation), np.array([chip.xc, -chip.yc])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return (np.array(places) - centre) @ turn.T + centre


def _box(corners):
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    return _numbers((x0, y0, x1 - x0, y1 - y0))


def _numbers(values):
    return " ".join(f"{value:.1f}" for value in values)
