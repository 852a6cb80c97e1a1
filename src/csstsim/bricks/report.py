"""The report of a campaign: one self-contained page of HTML, figures embedded, no scripts, no network."""

import base64
import html

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:72rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.2rem;border-bottom:1px solid #ccc}
table{border-collapse:collapse;margin:.8rem 0;font-size:.9rem}th,td{padding:.25rem .7rem;text-align:left;
border-bottom:1px solid #ddd}th{background:#f2f2f2}td.n{text-align:right;font-variant-numeric:tabular-nums}
img{max-width:100%;height:auto}.pass{color:#00674c}.fail{color:#b03a00;font-weight:bold}.none{color:#666}
figure{margin:1rem 0}figcaption{color:#555;font-size:.85rem}code{font-size:.85em;overflow-wrap:anywhere}
"""
VERDICT = {True: ("pass", "pass"), False: ("FAIL", "fail"), None: ("not judged", "none")}


def write_report(
    path, summary, results, *, exposures=(), files=(), figures=None, sky_map=None, spectra=(), provenance=None, times=()
):
    """Write the report to `path`; all text is escaped.

    summary      {label: value} of the campaign, shown first; key 'name' is the title
    results      list of validate_brick results (JSON-like)
    exposures    list of mappings with equal keys: one row each
    files        list of (label, link relative to the page) of the Level-0 files
    figures      {brick: PNG bytes}; sky_map: PNG bytes
    spectra      list of (title, PNG bytes) of spectroscopic frames
    provenance   {label: value}: version, hashes, seed
    times        list of mappings (step, jobs, wall s, CPU s, ...): one row each
    """
    from csstsim.atomic import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(
            page(summary, results, exposures, files, figures or {}, sky_map, spectra, provenance or {}, times),
            encoding="utf-8",
        )


def page(summary, results, exposures, files, figures, sky_map, spectra, provenance, times):
    """Return the page as text; arguments as in `write_report`."""
    gates = [(result["brick"], gate) for result in results for gate in result["gates"]]
    failed = sum(gate["passed"] is False for _, gate in gates)
    judged = sum(gate["passed"] is not None for _, gate in gates)
    verdict = f"{judged - failed} of {judged} judged gates pass; {len(gates) - judged} could not be judged."
    if judged == 0:
        verdict = "No gate could be judged: too few sources, or no thresholds."
    name = summary.get("name", "campaign")
    parts = [
        f"<h1>csstsim report: {_text(name)}</h1>",
        f'<p class="{"fail" if failed else "pass" if judged else "none"}">{verdict}</p>',
        _pairs({key: value for key, value in summary.items() if key != "name"}),
        _section("Sky", _image(sky_map, "Measured windows, by filter, and the NSIDE-256 bricks they touch")),
        _section("Gates", _gates(gates)),
        _section("Bands", _bands(results)),
        *(_brick(result, figures.get(result["brick"])) for result in results),
        _section("Spectra", "".join(_image(png, name) for name, png in spectra)),
        _section("Exposures", _rows(exposures)),
        _section("Level-0 files", _files(files)),
        _section("Run time", _rows(times)),
        _section("Provenance", _pairs(provenance)),
    ]
    head = f'<meta charset="utf-8"><title>{_text(name)} - csstsim report</title><style>{STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n{"".join(parts)}\n</body></html>\n'


def _text(value, digits=4):
    """Escaped text of a value; floats to `digits` significant figures, None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return html.escape(f"{value:.{digits}g}")
    return html.escape(str(value))


def _cell(value):
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return f'<td class="n">{_text(value)}</td>' if number else f"<td>{_text(value)}</td>"


def _table(head, rows):
    if not rows:
        return ""
    top = "".join(f"<th>{_text(title)}</th>" for title in head)
    return f"<table><tr>{top}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def _section(title, body):
    return f"<h2>{_text(title)}</h2>{body}\n" if body else ""


def _pairs(mapping):
    rows = (f"<tr><th>{_text(key)}</th><td>{_text(value, 10)}</td></tr>" for key, value in mapping.items())
    return f"<table>{''.join(rows)}</table>" if mapping else ""


def _rows(mappings):
    mappings = list(mappings)
    return _table(mappings[0], ["".join(map(_cell, row.values())) for row in mappings]) if mappings else ""


def _image(png, caption):
    if png is None:
        return ""
    data = base64.b64encode(png).decode("ascii")
    text = _text(caption)
    return f'<figure><img alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'


def _gates(gates):
    rows = []
    for brick, gate in gates:
        word, style = VERDICT[gate["passed"]]
        cells = "".join(map(_cell, (brick, gate["name"], gate["band"], gate["value"], gate["threshold"], gate["n"])))
        rows.append(f'{cells}<td class="{style}">{word}</td>')
    note = "<p>A gate with too few sources, or without a threshold, is not judged.</p>"
    return _table(("brick", "gate", "band", "value", "threshold", "sources", "verdict"), rows) + (note if rows else "")


def _bands(results):
    rows = []
    for result in results:
        for band, numbers in result["bands"].items():
            star, galaxy = numbers["star"], numbers["galaxy"]
            values = (
                result["brick"], band, numbers["frames"], _fixed(numbers["zeropoint"]), _fixed(numbers["depth_5sigma"]),
                _fixed(numbers["completeness"], 3), numbers["point_sources"], _fixed(star["median"], 4),
                _spread(star), star["n"],
                _fixed(galaxy["median"], 3), _spread(galaxy), galaxy["n"],
            )  # fmt: skip
            rows.append("".join(map(_cell, values)))
    head = (
        "brick", "band", "frames", "zero point [AB, 1 e-/s]", "5 sigma depth [AB]", "completeness", "point sources",
        "stars: out - in [mag]", "scatter", "stars", "galaxies: out - in [mag]", "scatter", "galaxies",
    )  # fmt: skip
    return _table(head, rows)


def _fixed(value, digits=2):
    return None if value is None else f"{value:.{digits}f}"


def _spread(numbers):
    return _fixed(numbers["sigma"], 3) if numbers["n"] >= 3 else None  # of one or two sources it says nothing


def _brick(result, png):
    residual = result["astrometry_mas"]
    if residual["east"]["n"]:
        east, north = (f"{part['median']:+.1f} (scatter {part['sigma']:.1f})" for part in residual.values())
        place = f"Positions out - in: east {east}, north {north} mas from {residual['east']['n']} bright stars."
    else:
        place = "Positions: no bright star to judge."
    count = f"{result['sources']} merged sources; {result['truth']} true objects on {result['frames']} frames."
    return _section(
        f"Brick {result['brick']}", f"<p>{count} {place}</p>" + _image(png, f"Validation of brick {result['brick']}")
    )


def _files(files):
    return "".join(f'<div><a href="{_text(link)}"><code>{_text(label)}</code></a></div>' for label, link in files)
