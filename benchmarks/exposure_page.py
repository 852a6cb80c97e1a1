"""A page of one file that zooms into a focal plane: pictures of chips in an SVG drawing, with the report's script."""

import base64
import io

from PIL import Image

from csstsim.base.shipped import ROOT

SCRIPT = ROOT / "src" / "csstsim" / "report" / "templates" / "report.js"
QUALITY, FINEST = 29, 85  # of WebP: the page stays below 1 MB; of single pixels
HEAD = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>One exposure of the Survey Camera, simulated</title>
<style>
html, body { margin: 0; height: 100%; background: #06070b; color: #a3a9b6; font: 15px/1.4 system-ui, sans-serif }
figure { margin: 0; height: 100%; display: flex; flex-direction: column }
.tools { display: flex; flex-wrap: wrap; gap: .4rem; padding: .5rem; align-items: center }
button { font: inherit; min-width: 2.4rem; min-height: 2.2rem }
button { color: #fff; background: #23262f; border: 1px solid #555 }
svg { flex: 1; min-height: 0; width: 100%; cursor: grab }
image.finest { image-rendering: pixelated }
rect { fill: none; stroke: #fff; stroke-dasharray: 4 3; vector-effect: non-scaling-stroke }
text { font: 700px system-ui, sans-serif; text-anchor: middle }
</style>
"""


def _url(rgb, quality):
    stream = io.BytesIO()
    Image.fromarray(rgb[::-1]).save(stream, "webp", quality=quality, method=6)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _shapes(shown, colour):
    """Return the SVG of a picture in its place on the focal plane, y down; a zoom has a dashed outline."""
    chip, window = shown.chip, shown.window
    x, top = chip.xc - chip.detector.nx / 2 + window.x0, -(chip.yc - chip.detector.ny / 2 + window.y1)
    turn = f'transform="rotate({-chip.rotation:g} {chip.xc:g} {-chip.yc:g})"'
    box = f'x="{x:g}" y="{top:g}" width="{window.nx}" height="{window.ny}" {turn}'
    finest, quality = ('class="finest" ', FINEST) if shown.step == 1 else ("", QUALITY)
    yield f'<image {finest}{box} preserveAspectRatio="none" href="{_url(shown.rgb, quality)}"/>'
    if colour is None:
        yield f"<rect {box}/>"
    else:
        below = -(chip.yc - chip.detector.ny / 2) + 720
        yield f'<text x="{chip.xc:g}" y="{below:g}" fill="{colour}">{chip.id} {chip.filter}</text>'


def write_page(path, whole, zooms, colours):
    """Write the page. whole: chips, zooms: parts of them (focal_plane_picture.Shown); colours: of the filters."""
    shapes = [shape for shown in whole for shape in _shapes(shown, colours[shown.chip.filter])]
    shapes += [shape for shown in zooms for shape in _shapes(shown, None)]
    half_x = max(abs(shown.chip.xc) + shown.chip.detector.nx / 2 for shown in whole) + 300
    half_y = max(abs(shown.chip.yc) + shown.chip.detector.ny / 2 for shown in whole) + 900
    box = f"{-half_x:g} {-half_y:g} {2 * half_x:g} {2 * half_y:g}"
    finest = min(zooms, key=lambda shown: shown.step)
    chip, window = finest.chip, finest.window
    detail = (chip.xc - chip.detector.nx / 2 + window.x0, -(chip.yc - chip.detector.ny / 2 + window.y1))
    detail = f"{detail[0]:g} {detail[1]:g} {window.nx} {window.ny}"
    buttons = (("in", "+"), ("out", "\u2212"), ("reset", "focal plane"), ("detail", "full resolution"))
    tools = "".join(f'<button type="button" data-zoom="{name}">{text}</button>' for name, text in buttons)
    note = "Wheel, drag, pinch or keys (+, -, 0, 2, arrows). Dashed squares are finer."
    path.write_text(
        f'{HEAD}<figure class="mosaic"><div class="tools">{tools}<span>{note}</span></div>\n'
        f'<svg class="plane" tabindex="0" viewBox="{box}"><g class="view">'
        f'<g class="exposure" data-number="0" data-box="{box}" data-detail="{detail}">'
        + "\n".join(shapes)
        + f"</g></g></svg></figure>\n<script>{SCRIPT.read_text()}</script></html>\n"
    )
    print(path, path.stat().st_size // 1000, "kB")
