"""The set of mutations: tests/mutants/set/<folder>.yaml, one fault an entry, checked against the source."""

import ast
from dataclasses import dataclass
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path("src", "csstsim")
TESTS = Path("tests")


@dataclass(frozen=True)
class Mutation:
    """One fault: `old`, found once in `file` (below src/csstsim), becomes `new`; `what` says it in a line.

    tests: of the tests that mirror the module, files or folders below tests, narrowest first. survives: why no test
    sees it, "" if one should.
    """

    folder: str
    file: str
    old: str
    new: str
    what: str
    tests: tuple
    survives: str = ""

    @property
    def name(self):
        """Return what its result is kept under."""
        return f"{self.file}: {self.what}"

    @property
    def module(self):
        """Return the dotted name of the mutated module."""
        return ".".join(("csstsim", *Path(self.file).with_suffix("").parts))

    def source(self, root=ROOT):
        """Return the text of the file as it is."""
        return (root / PACKAGE / self.file).read_text(encoding="utf-8")

    def fault(self, root=ROOT):
        """Return what is wrong with the entry, "" if nothing is."""
        if not (root / PACKAGE / self.file).is_file():
            return "no such file"
        text = self.source(root)
        if (found := text.count(self.old)) != 1:
            return f"old text found {found} times"
        try:
            ast.parse(text.replace(self.old, self.new))
        except SyntaxError as error:
            return f"is not Python: {error}"
        missing = [name for name in self.tests if not (root / TESTS / name.split("::")[0]).exists()]
        return f"no test {missing}" if missing or not self.tests else ""


def load(folders=(), root=ROOT):
    """Return the list of Mutations of these folders of the set, all if none is named."""
    files = sorted((Path(__file__).parent / "set").glob("*.yaml"))
    return [
        _entry(file.stem, values, root)
        for file in files
        if not folders or file.stem in folders
        for values in yaml.safe_load(file.read_text(encoding="utf-8"))
    ]


def _entry(folder, values, root):
    named = values.pop("tests", None) or mirror(values["file"], root)
    return Mutation(folder=folder, **values, tests=tuple(named.split() if isinstance(named, str) else named))


def mirror(file, root):
    """Return the tests that mirror a module."""
    top, name = Path(file).parts[0], f"test_{Path(file).name}"
    return [str(path.relative_to(root / TESTS)) for path in sorted((root / TESTS / top).rglob(name))]
