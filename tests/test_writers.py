"""All code that writes a file writes to base.files.atomic's temporary; found in the source, so that none is missed.

A call that makes or changes a file is found by its name (and by its mode if it may also read). The file must be a
variable that `with atomic_path(...) as variable` binds around the call in the same function, or an argument of a
function of HELPERS, whose callers must then meet the same condition.
"""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "csstsim"
# Names of calls, and which argument is the file: a number, or "self" for the object the method is of
ALWAYS = {
    "write_text": "self", "write_bytes": "self", "writeto": 0, "savefig": 0, "write_table": 1, "write_metadata": 1,
    "ParquetWriter": 0, "save": 0, "savez": 0, "savetxt": 0, "tofile": 0, "to_csv": 0, "to_parquet": 0, "copy2": 1,
    "copyfile": 1, "copytree": 1, "rename": "self", "replace_file": 1, "symlink_to": "self", "touch": "self",
    "link": 1, "hardlink_to": "self", "NamedTemporaryFile": 0, "mkstemp": 0, "truncate": 0,
}  # fmt: skip
BY_MODE = {"open": (0, 1), "File": (0, 1), "FITS": (0, 1), "memmap": (0, 2)}  # (file, mode); Path.open: ("self", 0)
READS = {"os", "fits", "Image", "SPK"}  # owners of an `open` whose first argument is the file
# Functions that write to the path they are given, by the position of that argument: (module, function)
HELPERS = {
    ("io/fits_writing.py", "write_hdus"): 0,
    ("io/fits_writing.py", "compress"): 0,
    ("io/fits_writing.py", "_rewrite_checksums"): 0,
}
ALLOWED = {
    ("io/output_owner.py", "claim_output", "open"): "of two campaigns that come at once only one may make the file",
    ("stages/parts/shared.py", "make_or_link", "link"): "a whole file, which a second campaign finds and leaves",
    (
        "campaign/running/one_by_one.py",
        "_keep",
        "link",
    ): "a whole file, in a folder that is not read before it has its name",
    ("campaign/running/one_by_one.py", "_link", "link"): "a whole file",
    ("command_line/group.py", "_discard_output", "open"): "null: os.devnull",
    ("command_line/group.py", "quiet_output", "open"): "null: os.devnull",
    ("base/files/atomic.py", "_flush", "open"): "to be flushed: os.O_RDONLY",
    ("campaign/running/one_by_one.py", "_keep", "write_text"): "in a folder that is not read before it has its name",
    ("campaign/running/one_by_one.py", "_keep", "rename"): "a folder of second names of finished files",
    ("measure/spectra/spectra_figures.py", "_png", "savefig"): "bytes in memory",
    ("report/figures.py", "png", "savefig"): "bytes in memory",
    ("report/pictures.py", "_webp", "save"): "bytes in memory",
    ("simulation/frame_html.py", "_png", "save"): "bytes in memory",
    ("base/process/compiled_cache.py", "_lock_file", "open"): "a file without content, for locks",
    ("stages/warm.py", "_campaign", "write_text"): "in a temporary folder",
}


def _name(call):
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _argument(call, place):
    if place == "self":
        return call.func.value if isinstance(call.func, ast.Attribute) else None
    return call.args[place] if len(call.args) > place else None


def _target(call):
    """Return (whether the call writes a file, the node of the file)."""
    name = _name(call)
    helper = {function: place for (_, function), place in HELPERS.items()}
    if name in ALWAYS | helper:
        return True, _argument(call, (ALWAYS | helper)[name])
    if name not in BY_MODE:
        return False, None
    owner = call.func.value if isinstance(call.func, ast.Attribute) else None
    of_path = name == "open" and owner is not None and getattr(owner, "id", "") not in READS
    file, mode = ("self", 0) if of_path else BY_MODE[name]
    said = _argument(call, mode) or next((k.value for k in call.keywords if k.arg in ("mode", "flags")), None)
    if said is None:
        return name == "memmap", _argument(call, file)
    known = str(said.value) if isinstance(said, ast.Constant) else "w"  # a mode that is computed may write
    return bool(set(known) & set("wax+")), _argument(call, file)


def _plain(node):
    """The variable in `Path(variable)` or `variable`."""
    if isinstance(node, ast.Call) and _name(node) == "Path" and node.args:
        node = node.args[0]
    return node.id if isinstance(node, ast.Name) else None


def writes(source, module):
    """Return {(module, function, call): line} of what writes to a file that is not a temporary."""
    found = {}

    def look(node, function, safe):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            place = HELPERS.get((module, node.name))
            safe = frozenset() if place is None else frozenset({node.args.args[place].arg})
            function = node.name
        if isinstance(node, ast.With):
            for item in node.items:  # in order: a later one may open what an earlier one binds
                look(item.context_expr, function, safe)
                if isinstance(item.context_expr, ast.Call) and _name(item.context_expr) == "atomic_path":
                    safe |= {item.optional_vars.id}
            for child in node.body:
                look(child, function, safe)
            return
        if isinstance(node, ast.Call):
            wrote, file = _target(node)
            if wrote and _plain(file) not in safe:
                found[module, function, _name(node)] = node.lineno
        for child in ast.iter_child_nodes(node):
            look(child, function, safe)

    look(ast.parse(source), "", frozenset())
    return found


def test_every_file_is_written_under_a_temporary_name():
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        if "bench" not in path.relative_to(SOURCE).parts:  # figures of the simulator itself: no campaign reads them
            found |= writes(path.read_text(), str(path.relative_to(SOURCE)))
    assert {place: line for place, line in found.items() if place not in ALLOWED} == {}
    assert found.keys() == ALLOWED.keys(), "an exception that is none any more"


@pytest.mark.parametrize(
    "line",
    [
        "open(path, 'w')", "open(path, mode='ab')", "path.open('x')", "path.write_text('')", "np.memmap(path, 'i2')",
        "Path(path).write_bytes(b'')", "h5py.File(path, 'w')", "fitsio.FITS(path, 'rw', clobber=True)",
        "hdus.writeto(path)", "pq.write_table(t, path)", "figure.savefig(path)", "open(path, how)",
        "write_hdus(path, [])",
    ],
)  # fmt: skip
def test_a_writer_to_a_final_name_is_seen(line):
    assert writes(f"def f(path, how):\n    {line}\n", "m.py")
    assert writes(f"def f(path, how):\n    with atomic_path(path) as temporary:\n        {line}\n", "m.py")
    good = line.replace("path", "temporary", 1)
    assert not writes(f"def f(path, how):\n    with atomic_path(path) as temporary:\n        {good}\n", "m.py")


@pytest.mark.parametrize("line", ["open(path)", "open(path, 'rb')", "h5py.File(path, 'r')", "fitsio.FITS(path)"])
def test_a_reader_is_none(line):
    assert not writes(f"def f(path):\n    {line}\n", "m.py")
