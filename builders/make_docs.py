"""Write config/README.md, config/schema/*.json and the columns in examples/my_catalogue/README.md.

Also the tables of gates in docs/validation.md.

    python builders/make_docs.py          --check: only look

The models in csstsim.campaign.config and sections, the layers' Param and the records of
csstsim.measure.bricks.validation.gates are the only source; `make test` forbids drift.
"""

import importlib
import json
import sys
from pathlib import Path

from pydantic import BaseModel

from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.model import Model
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.config import Campaign
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.galaxy_shapes import part_rows
from csstsim.catalog.table import OPTIONAL, columns_with
from csstsim.instrument.camera import load_camera
from csstsim.measure.bricks.validation.gates import register
from csstsim.simulation.observation import Observation
from csstsim.simulation.sim_steps import known_layers

CONFIG = Path(__file__).parents[1] / "config"
TABLES = CONFIG.parent / "examples" / "my_catalogue" / "README.md"
GATES = CONFIG.parent / "docs" / "validation.md"
BEGIN, END = "<!-- columns: python builders/make_docs.py -->\n", "<!-- end of columns -->"
BEGIN_GATES, END_GATES = "<!-- gates: python builders/make_docs.py -->\n", "<!-- end of gates -->"
SCOPES = {
    "frame": "exposure and chip", "band": "band", "colour": "pair of neighbouring bands", "brick": "brick",
    "spectra": "spectroscopic exposure and chip", "twins": "component of shear",
}  # fmt: skip
SHORTHANDS = {  # of csstsim.catalog.own_table
    "type": "star, galaxy, quasar, asteroid or satellite [default: star]; or `obj_type`: 0, 1, 2, 3, 4",
    "size": "arcsec, half-light radius of a galaxy's disk and bulge: sqrt(a b) of the half-light ellipse",
    "n": "Sersic index of a galaxy without a bulge, 0.3 to 6.2 [default: 1]",
    **part_rows.SHORTHANDS,
}
NOTE = "*Written by `python builders/make_docs.py` from the models; edit those, not this file.*\n"
INTRO = """# Configuration: every key of a campaign

This page lists the keys of campaign files and of layer lists, with default, unit and meaning.

- A **campaign** file states what to simulate. `campaign.yaml` is the demo; others are `c9_w1.yaml` ... `c9_w5.yaml` and
  `calibration.yaml`. Paths in it are relative to the folder of the file.
- An **observation** file (`observations/`) lists the layers of an exposure, in order.
- `instrument/` has the data of the camera, `universe/` those of the embedded universe. Every number has its source.
- `changing/` has the parameters of moving and variable objects. They are not simulated by default.
- `costs.yaml` has the time and memory of a job of each rule, for `csstsim plan` and `csstsim status`.
- `curves/` has response curves of other surveys, for catalogues with magnitudes in their bands.

An unknown key, a wrong type or a value out of range is refused before any work. The error names file, key and allowed
values. `schema/` has JSON schemas for editors.
"""
LAYERS = """Unit: electrons or DN, before and after the layer. Pixels: the active pixels of the window, or the readout
frame with prescan and overscan. "Not before": layers that must come first if the list has them. Equations:
[docs/layers.md](../docs/layers.md).
"""


def rows(model, prefix=""):
    """Yield (key, default, description) of a model's fields, nested ones with dotted keys."""
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else field.get_default(call_default_factory=True)
        if isinstance(default, Model):
            yield from rows(type(default), f"{prefix}{name}.")
            continue
        yield f"{prefix}{name}", default, field.description
        for inner in getattr(field.annotation, "__args__", ()):
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                yield from rows(inner, f"{prefix}{name}.")


def table(model):
    lines = ["| key | default | meaning |", "|---|---|---|"]
    for key, default, text in rows(model):
        shown = "null" if default is None else list(default) if isinstance(default, tuple) else default
        lines.append(f"| `{key}` | {shown} | {text or ''} |")
    return "\n".join(lines)


def layer_table(modules):
    """Return the table of all layers {name: module}: units, pixels, order and parameters."""
    lines = ["| layer | stage | unit | pixels | exposures | not before | parameters |", "|---|---|---|---|---|---|---|"]
    for name, module in modules.items():
        unit, pixels = (" to ".join(dict.fromkeys(getattr(module, key, ("either",)))) for key in ("UNITS", "FRAME"))
        exposures, after = (", ".join(getattr(module, key, ())) for key in ("EXPOSURES", "AFTER"))
        parameters = ", ".join(f"`{key}`" for key in module.Param.model_fields)
        cells = f"[`{name}`](#{name})", module.STAGE, unit, pixels, exposures or "all", after, parameters
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def columns(text):
    """Return the text of TABLES with the columns of a user's table between BEGIN and END."""
    bands, own = load_camera(SHIPPED / "instrument").bands, {}
    for name, (_, _, meaning) in (columns_with(bands) | OPTIONAL).items():
        own["mag_*" if name.startswith("mag_") else name] = meaning
    own |= {
        name: f"{meaning} [left out: it does not {'move' if name in changing.MOTION else 'vary'}]"
        for name, (_, _, meaning) in changing.COLUMNS.items()
    }
    own["id"] += " [default: counted from 1]"
    named = ", ".join(f"`mag_{band}`" for band in bands)
    own["mag_*"] = f"AB, observed, before lensing; in the shipped camera's bands: {named}"
    own = {name: own[name] for name in ("ra", "dec", "mag_*")} | SHORTHANDS | own  # what is needed comes first
    own = {name: meaning for name, meaning in own.items() if name not in ("obj_type", "flags")}
    before, rest = text.split(BEGIN)
    lines = ["| column | unit, meaning |", "|---|---|", *(f"| `{name}` | {meaning} |" for name, meaning in own.items())]
    return f"{before}{BEGIN}{chr(10).join(lines)}\n{END}{rest.split(END)[1]}"


def gates(text):
    """Return the text of GATES with the tables of all gates, a family each, between BEGIN_GATES and END_GATES."""
    before, rest = text.split(BEGIN_GATES)
    lines = []
    for family in register.FAMILIES:
        lines += [f"### {family.__doc__.splitlines()[0].rstrip('.')}", ""]
        lines += ["| gate | of each | statistic | key and default | chance |", "|---|---|---|---|---|"]
        lines += [f"| {' | '.join(cells(gate))} |" for gate in family.GATES]
        lines.append("")
    return f"{before}{BEGIN_GATES}{chr(10).join(lines)}{END_GATES}{rest.split(END_GATES)[1]}"


def cells(gate):
    """Return the cells of a gate's row."""
    threshold = gate.threshold_in(ValidateConfig())
    default = " to ".join(map(str, threshold)) if isinstance(threshold, tuple) else f"{threshold:g}"
    key = f"`{gate.threshold}`: " if isinstance(gate.threshold, str) else ""
    chance = f"{gate.sigmas:g} sigma" if gate.sigmas else "none"
    return gate.name, SCOPES[gate.scope], gate.tests, f"{key}{default} {gate.unit}".rstrip(), chance


def documents():
    """Return {path: text} of everything generated."""
    modules = {name: importlib.import_module(f"csstsim.layers.{name}") for name in known_layers()}
    text = [INTRO, "## Campaign", table(Campaign), "", "## Layers of an observation file", ""]
    text += [LAYERS, layer_table(modules), ""]
    for name, module in modules.items():
        text += [f"### `{name}`", "", module.__doc__.splitlines()[0], ""]
        text += [f"Stage `{module.STAGE}`; {module.UNITS[0]} in, {module.UNITS[1]} out.", ""]
        if module.Param.model_fields:
            text += [table(module.Param), ""]
    files = {
        CONFIG / "README.md": "\n".join([*text, NOTE]), TABLES: columns(TABLES.read_text()),
        GATES: gates(GATES.read_text()),
    }  # fmt: skip
    for model in (Campaign, Observation):
        schema = model.model_json_schema()
        if model is Observation:
            add_layers(schema, modules)
        else:  # a variant has keys of the campaign
            keys = {"enum": [key for key in schema["properties"] if key != "variants"]}
            schema["properties"]["variants"]["additionalProperties"]["propertyNames"] = keys
        text = json.dumps(schema, indent=1, sort_keys=True) + "\n"
        files[CONFIG / "schema" / f"{model.__name__.lower()}.json"] = text
    return files


def add_layers(schema, modules):
    """Add the parameters of each layer to the schema of an observation file; those of one's own layers may be any."""
    paper = [name for layer in read_yaml(CONFIG / "observations" / "science_paper.yaml")["layers"] for name in layer]
    definitions = schema.setdefault("$defs", {})
    layers = {}
    for name, module in modules.items():
        layer = module.Param.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        definitions |= {f"{name}.{model}": inner for model, inner in layer.pop("$defs", {}).items()}
        layers[name] = {"anyOf": [layer, {"type": "null"}], "description": module.__doc__.splitlines()[0]}
    layers |= {name: layers[name.lower()] for name in paper}  # as the paper writes them
    own = schema["properties"]["layers"]["items"].pop("additionalProperties")
    own_layers = {"patternProperties": {r"\.": own}, "additionalProperties": False}
    schema["properties"]["layers"]["items"] |= {"properties": layers} | own_layers


def stale():
    """Return the paths of files that are missing or differ from the models."""
    return [path for path, text in documents().items() if not path.exists() or path.read_text() != text]


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        sys.exit("\n".join(f"{path} is stale: run python builders/make_docs.py" for path in stale()) or 0)
    for path, content in documents().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(content)
        print(path)
