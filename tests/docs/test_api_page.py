"""docs/api.md: the docstring of each name on the page lists its parameters and what it returns, arrays with shapes.

The names are those of the page's autodoc directives, with the public methods of classes that have `:members:`.
"""

import functools
import importlib
import inspect
import re
import runpy
from pathlib import Path

import pytest

from csstsim.simulation.layer_contract import UNIT

DOCS = Path(__file__).parents[2] / "docs"
SECTIONS = runpy.run_path(str(DOCS / "plain_docstrings.py"))["sections"]
DIRECTIVE = re.compile(r"(?m)^\.\. auto(\w+):: (\S+)((?:\n   :.*)*)")
# (n,) or (ny, nx); a function of numbers takes arrays of any shape
SHAPE = re.compile(r"\((\w[\w \-+*/]*)?,[^()]*\)|\bshape\b|\bfloat or ndarray\b|\bbroadcast\b")
KIND = re.compile(rf"{UNIT.pattern}|\b(bool|int|u?int(8|16|32)|mask|indices|units?|redshifts?|dimensions)\b", re.I)
ARRAY = re.compile(r"\b(\w*Array|Floats|ndarray)\b")


def names_on(text):
    """Return the dotted names of a page: of its directives, and of the members that they show."""
    names = []
    for kind, name, options in DIRECTIVE.findall(text):
        members = public_members(name) if ":members:" in options else []
        names += members if kind == "module" else [name, *members]
    return names


def public_members(name):
    """Return the dotted names of what a class or module defines that has a docstring, without private names."""
    owner = resolve(name)
    inside = {
        key: value
        for key, value in vars(owner).items()
        if not key.startswith("_") and (callable(unwrapped(value)) or is_property(value))
    }
    if inspect.ismodule(owner):
        inside = {key: value for key, value in inside.items() if getattr(value, "__module__", None) == name}
    return [f"{name}.{key}" for key, value in inside.items() if inspect.getdoc(value)]


def resolve(name):
    """Return the object of a dotted name; a method as its class has it, with its decorator."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = inspect.getattr_static(found, part) if inspect.isclass(found) else getattr(found, part)
        return found
    raise LookupError(name)


def unwrapped(found):
    return getattr(found, "__func__", found)


def is_property(found):
    return isinstance(found, (property, functools.cached_property))


def faults(name, found=None):
    """Return what the docstring of a name lacks, one line each."""
    found = unwrapped(resolve(name) if found is None else found)
    if is_property(found) or (inspect.isclass(found) and issubclass(found, Exception)):
        return [] if inspect.getdoc(found) else [f"{name}: no docstring"]
    sections = {heading: entries(body) for heading, body in SECTIONS(inspect.getdoc(found).split("\n"))}
    listed = sections.get("Parameters", {}) | sections.get("Attributes", {})
    lines = []
    takes = parameters(found)
    lines += [f"{name}: parameter {key} is not described" for key in takes if key.lstrip("*") not in listed]
    known = {key.lstrip("*") for key in takes}
    lines += [f"{name}: there is no parameter {key}" for key in sections.get("Parameters", {}) if key not in known]
    for key, annotation in takes.items():
        text = listed.get(key.lstrip("*"), "")
        if text and ARRAY.search(annotation) and not (SHAPE.search(text) and KIND.search(text)):
            lines.append(f"{name}: the array {key} has no shape, or neither unit nor type: {text}")
    if not inspect.isclass(found):
        result = str(inspect.signature(found).return_annotation)
        returned = sections.get("Returns", sections.get("Yields"))
        if result != "None" and not returned:
            lines.append(f"{name}: Returns is missing")
        text = " ".join((returned or {}).values())
        if ARRAY.search(result) and returned and not (SHAPE.search(text) or text.startswith("float")):
            lines.append(f"{name}: the returned array has no shape")
    return lines


def entries(body):
    """Return {name: type and description} of a section's lines; the lines of Returns and Raises name types."""
    found = {}
    names = []
    for line in body:
        if line.strip() and not line.startswith(" "):
            head, _, kind = line.partition(" : ")
            names = [name.strip().lstrip("*") for name in head.split(",")] if kind else [line.lstrip("*")]
            found |= dict.fromkeys(names, line)
        else:
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
    return found


def parameters(found):
    """Return {name: annotation} of what a function, method or class takes; ** and * are part of the name."""
    marks = {inspect.Parameter.VAR_KEYWORD: "**", inspect.Parameter.VAR_POSITIONAL: "*"}
    taken = list(inspect.signature(found).parameters.items())
    is_method = not inspect.isclass(found) and "." in found.__qualname__.rpartition("<locals>.")[2]
    return {marks.get(one.kind, "") + key: str(one.annotation) for key, one in taken[is_method:] if key[0] != "_"}


PAGE = names_on((DOCS / "api.md").read_text())


@pytest.mark.parametrize("name", PAGE)
def test_parameters_and_results_are_described(name):
    assert not faults(name)


def test_the_page_lists_each_name_once():
    assert len(PAGE) > 100
    assert sorted(set(PAGE)) == sorted(PAGE)


SOUND = """Return a flux.

Parameters
----------
rows, columns : (n,) array of int
    Numbers.
**others : object
    Others.

Returns
-------
(n, 4) array of float
    Flux [electron / s].
"""
SPOILT = {
    "parameter columns is not described": ("rows, columns", "rows"),
    "there is no parameter cols": ("rows, columns", "rows, columns, cols"),
    "the array rows has no shape": ("(n,) array", "array"),
    "parameter **others is not described": ("**others : object\n    Others.\n", ""),
    "Returns is missing": ("Returns\n-------", ""),
    "the returned array has no shape": ("(n, 4) array", "array"),
}


def documented(text):
    def flux(rows, columns, **others):
        raise NotImplementedError

    flux.__doc__ = text
    flux.__annotations__ = {"rows": "IntArray", "columns": "IntArray", "others": "object", "return": "FloatArray"}
    return flux


def test_a_sound_docstring_has_no_faults():
    assert not faults("flux", documented(SOUND))


@pytest.mark.parametrize("fault", SPOILT)
def test_each_lack_is_found(fault):
    old, new = SPOILT[fault]
    assert SOUND.count(old) == 1
    assert [line for line in faults("flux", documented(SOUND.replace(old, new))) if fault in line]
