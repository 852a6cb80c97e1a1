"""The report of a campaign: one self-contained page of HTML, figures, style and script embedded, no network."""

from importlib.resources import files as package_files

from csstsim.bricks import verdict as verdicts
from csstsim.bricks.gates import FEW
from csstsim.report.band_table import band_numbers, band_table
from csstsim.report.markup import (
    Link,
    Verdict,
    folded,
    image,
    inline,
    mappings,
    pairs,
    paragraph,
    section,
    table,
    text,
)  # fmt: skip

NAMED = 10  # failing gates named at the top
UNFOLDED = 4  # brick sections shown open
# Nothing may be fetched, whatever a name in the tables holds.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
GATE = {"name": "gate", "band": "band", "value": "value", "threshold": "threshold", "n": "sources"}


def write_report(
    path, summary, results, *, exposures=(), files=(), figures=None, sky_map=None, mosaic="", spectra=(), links=None,
    provenance=None, times=(), labels=None,
):  # fmt: skip
    """Write the report to `path`; all text is escaped.

    summary      {label: value} of the campaign, shown first; key 'name' is the title
    results      list of validate_brick results (JSON-like)
    exposures    list of mappings: one row each; values may be markup.Link or tuples of them
    files        list of (label, link relative to the page): other files of the campaign
    figures      {brick: PNG bytes}; sky_map: PNG bytes
    mosaic       HTML of the focal plane (report.mosaic)
    spectra      list of (title, PNG bytes or None, *Links) of spectroscopic frames
    links        {brick: (Link, ...)}: its files
    provenance   {label: value}: version, hashes, seed
    labels       {band: as the camera writes its name}
    times        list of mappings (step, jobs, wall s, CPU s, ...): one row each
    """
    from csstsim.base.files.atomic import atomic_path

    name = summary.get("name", "campaign")
    judged = verdicts.judge(results)
    results = sorted(results, key=lambda result: -_counts(result)["fail"])  # stable: then by number, as they came
    links, labels = links or {}, labels or {}
    sections = [
        ("summary", "Summary", pairs({key: value for key, value in summary.items() if key != "name"})),
        ("gates", "Gates", _gates(judged["gates"])),
        ("sky", "Sky", image(sky_map, "Windows by filter, the NSIDE-256 bricks they touch, and the pointings")),
        ("plane", "Focal plane", mosaic),
        ("bricks", "Bricks", _brick_table(results, links, labels)),
        ("validation", "Validation by brick", _bricks(results, figures or {}, links, labels)),
        ("spectra", "Spectra", _spectra(spectra)),
        ("exposures", "Exposures and Level-0 files", mappings(exposures, "exposures")),
        ("files", "Files", table(("file",), [(Link(*file),) for file in files], "files")),
        ("times", "Run time by rule", mappings(times)),
        ("provenance", "Provenance", pairs(provenance or {})),
    ]
    with atomic_path(path) as temporary:
        temporary.write_text(_page(name, judged, sections), encoding="utf-8")


def _page(name, judged, sections):
    contents = " ".join(inline(Link(title, f"#{key}")) for key, title, body in sections if body)
    body = "".join(section(*part) for part in sections)
    here = package_files("csstsim.report")
    style, script = (here.joinpath(file).read_text(encoding="utf-8") for file in ("report.css", "report.js"))
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<title>{text(name)} - csstsim report</title>\n<style>\n{style}</style></head>\n"
        f"<body><h1>csstsim report: {text(name)}</h1>{_headline(judged)}<nav>{contents}</nav>\n{body}"
        f"<script>\n{script}</script></body></html>\n"
    )


def _headline(judged):
    """The verdict, and by name the gates that fail."""
    style = {True: "pass", False: "fail", None: "none"}[judged["passed"]]
    failing = [gate for gate in judged["gates"] if gate["passed"] is False]
    items = [inline(Link(verdicts.sentence(gate), f"#brick-{gate['brick']}")) for gate in failing[:NAMED]]
    items += [inline(Link(f"and {len(failing) - NAMED} more", "#gates"))] if len(failing) > NAMED else []
    named = f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>" if items else ""
    return paragraph(verdicts.headline(judged), f"verdict {style}") + named


def _gates(gates):
    """Counts by gate, the failing gates, then the rest; a gate may have more keys than those known here."""
    if not gates:
        return ""
    keys = dict(GATE) | {key: key for gate in gates for key in gate if key not in ("brick", "passed", *GATE)}
    counts = [(name, *counts.values()) for name, counts in verdicts.by_name(gates).items()]
    rows = [
        (Link(str(gate["brick"]), f"#brick-{gate['brick']}"), Verdict(gate["passed"]), *(gate.get(key) for key in keys))
        for gate in gates
    ]
    head = ("brick", "verdict", *keys.values())
    failing = sum(gate["passed"] is False for gate in gates)  # they come first
    listed = table(head, rows[:failing], "gates that fail")
    listed += table(head, rows[failing:], "gates that pass or could not be judged")
    note = f"A gate with fewer than {FEW} sources, or without a threshold, is not judged."
    return table(("gate", *verdicts.NAMES.values()), counts) + listed + paragraph(note)


def _counts(result):
    return verdicts.count(result["gates"])


def _brick_table(results, links, labels):
    """One row a brick, failing ones first."""
    bands = list(dict.fromkeys(band for result in results for band in result["bands"]))
    rows = []
    for result in results:
        counts, pix = _counts(result), result["brick"]
        row = {
            "brick": Link(str(pix), f"#brick-{pix}"),
            "verdict": Verdict(False if counts["fail"] else True if counts["pass"] else None),
            "gates pass / fail / not judged": " / ".join(map(str, counts.values())),
            "frames": result["frames"], "sources": result["sources"],
            "true objects": result["truth"], "purity": result["purity"],
        }  # fmt: skip
        for band in bands:
            row[labels.get(band, band)] = result["bands"].get(band, {}).get("completeness")
        rows.append(row | ({"files": links[pix]} if pix in links else {}))
    note = "A column headed by a band has the completeness of point sources in it." if rows else ""
    return paragraph(note) + mappings(rows, "bricks")


def _bricks(results, figures, links, labels):
    """A section a brick; of many, all but a few folded."""
    parts = []
    for place, result in enumerate(results):
        pix = result["brick"]
        body = _brick(result, figures.get(pix), links.get(pix, ()), labels)
        if place >= UNFOLDED:
            body = folded(verdicts.tally(_counts(result)), body)
        parts.append(section(f"brick-{pix}", f"Brick {pix}", body, level=3))
    return "".join(parts)


def _residual(numbers):
    scatter = "" if numbers["sigma"] is None else f" (scatter {numbers['sigma']:.1f})"
    return f"{numbers['median']:+.1f}{scatter}"


def _brick(result, png, links, labels):
    residual = result["astrometry_mas"]
    if residual["east"]["n"]:
        east, north = (_residual(residual[k]) for k in ("east", "north"))
        place = f"Positions out - in: east {east}, north {north} mas from {residual['east']['n']} bright stars."
    else:
        place = "Positions: no bright star to judge."
    count = f"{result['sources']} merged sources; {result['truth']} true objects on {result['frames']} frames."
    return (
        paragraph(f"{count} {place}")
        + paragraph(links)
        + band_table(result, labels)
        + image(png, f"Validation of brick {result['brick']}")
        + folded("all numbers by band", band_numbers(result, labels))
    )


def _spectra(spectra):
    shown = [image(png, title) + paragraph(tuple(links)) for title, png, *links in spectra if png is not None]
    rest = [(title, tuple(links)) for title, png, *links in spectra if png is None]
    return "".join(shown) + table(("not shown here", "files"), rest, "more")
