"""The commands whose figures are recorded: benchmarks/commands.yaml, one entry a record."""

import importlib.util
import os
import shlex
import shutil
from dataclasses import dataclass, field
from functools import cache

from evidence import ROOT

import yaml

FILE = ROOT / "benchmarks" / "commands.yaml"


@dataclass(frozen=True)
class Command:
    """One command: its name, which is its record's; the words that run it in full and at the size of seconds.

    `modules`, `programs` and `folders` are what it needs besides the project's own environment. A word of `full` in
    capital letters is a folder that the user has (`--folder MCTI=path`). `after` are names of commands whose results
    it reads. `reaches` names packages or files that it uses without importing or naming them. `makes` are folders of
    results/ in which it goes on after a stop; what other code or data made there is removed first.
    """

    name: str
    what: str
    full: str
    toy: str = ""
    modules: tuple[str, ...] = ()
    programs: tuple[str, ...] = ()
    folders: dict[str, str] = field(default_factory=dict, hash=False)
    after: tuple[str, ...] = ()
    reaches: tuple[str, ...] = ()
    makes: tuple[str, ...] = ()

    @property
    def script(self) -> str:
        """The path of its script, relative to the repository."""
        return shlex.split(self.full)[1]

    @property
    def toy_words(self) -> list[str]:
        """The words of its run at the size of seconds."""
        return shlex.split(self.toy or f"{self.full} --toy")

    def words(self, folders: dict[str, str]) -> list[str]:
        """Return the words of its full run, with the user's folders in place of their names."""
        return [folders.get(word, word) for word in shlex.split(self.full)]

    def lacks(self, folders: dict[str, str]) -> list[str]:
        """Return what this machine lacks for the full run."""
        modules = [f"Python module {name}" for name in self.modules if importlib.util.find_spec(name) is None]
        programs = [f"program {name}" for name in self.programs if not shutil.which(name)]
        absent = [f"folder {name}: {what}" for name, what in self.folders.items() if name not in folders]
        return modules + programs + absent

    def is_run_by(self, arguments: list[str], toy: bool) -> bool:
        """Tell whether a script called with these arguments is the full run, or that at the size of seconds."""
        mine, theirs = (self.toy_words if toy else shlex.split(self.full))[1:], list(arguments)
        if len(mine) != len(theirs) or (ROOT / mine[0]) != (ROOT / os.path.abspath(theirs[0])):
            return False
        return all(a == b or a in self.folders for a, b in zip(mine[1:], theirs[1:], strict=True))


@cache
def commands() -> dict[str, Command]:
    """Return all commands by name, in the order of the file."""
    found = {}
    for name, entry in yaml.load(FILE.read_text(), yaml.CSafeLoader).items():
        lists = {key: tuple(entry.pop(key, ())) for key in ("modules", "programs", "after", "reaches", "makes")}
        found[name] = Command(name=name, **entry, **lists)
    return found
