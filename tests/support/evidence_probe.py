"""A script of the repository's form in a folder of its own, with its records, for the tests of evidence."""

import argparse
import importlib
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "benchmarks"))
commands, dependencies, listing, pages, record, renewal, run = (
    importlib.import_module(f"evidence.{name}")
    for name in ("commands", "dependencies", "listing", "pages", "record", "renewal", "run")
)


def command(name="probe", **changes):
    return commands.Command(name=name, what="a probe", full=f"python benchmarks/{name}.py", **changes)


def probe_in(tmp_path, monkeypatch):
    """Make a script of the repository's form in a folder, and the command that runs it; yield the script's folder."""
    for module in (commands, dependencies, listing, pages, record, renewal, run):
        monkeypatch.setattr(module, "ROOT", tmp_path, raising=False)
    folder = tmp_path / "benchmarks"
    folder.mkdir()
    monkeypatch.setattr(dependencies, "SCRIPTS", (folder,))
    monkeypatch.setattr(dependencies, "_data", lambda: {"numbers.yaml": (folder / "numbers.yaml",)})
    monkeypatch.setattr(record, "RECORDS", tmp_path / "records")
    (folder / "numbers.yaml").write_text("a: 1\n")
    (folder / "beside.py").write_text('"""Doc."""\n\nNAME = "numbers.yaml"\n')
    (folder / "probe.py").write_text(
        '"""Doc."""\nfrom beside import NAME\n\n\ndef f():\n    """Doc."""\n    return 1\n'
    )
    known = {"probe": command()}
    for module in (record, pages, listing, run):
        monkeypatch.setattr(module, "commands", lambda: known, raising=False)
    forget(dependencies, pages)
    yield folder
    forget(dependencies, pages)


def forget(*modules):
    """Empty the caches of modules, but the graph of the package's imports."""
    for each in (value for module in modules for value in vars(module).values()):
        if hasattr(each, "cache_clear") and each is not dependencies._graph:
            each.cache_clear()


def digests():
    forget(dependencies)
    return dependencies.depends(command())


def made(probe, monkeypatch, *arguments, **values):
    """Run a record as the script would; return its content."""
    monkeypatch.setattr(sys, "argv", [str(probe / "probe.py")])
    monkeypatch.chdir(probe.parent)
    with record.Record(argparse.ArgumentParser(), arguments) as made_one:
        for name, (value, named) in values.items():
            made_one.value(name, value, f"the {name}", **named)
    pages.record.cache_clear()
    pages.is_stale.cache_clear()
    return record.read("probe")
