"""Every command that a page shows exists: its program, its verb, its options, the files of the repository it names.

Benchmarks are run at toy size by `make toys`, tutorials by `make tutorials`; this test sees a name that is gone.
"""

import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import click
import pytest

from csstsim.command_line.main import main as csstsim

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(p for pattern in ("*.md", "docs/*.md", "docs/tutorials/*.md", "*/README.md", "examples/*/README.md")
               for p in ROOT.glob(pattern) if p.name not in ("CHANGES.md", "VISION.md"))  # fmt: skip
PROGRAMS = "csstsim", "python", "make", "pytest"
BLOCK = re.compile(r"(?ms)^ *```[^\n]*\n(.*?)^ *```|^((?: {4}[^\n]*\n)+)|`((?:csstsim|python|make|pytest) [^`\n]*)`")
FOLDERS = r"(benchmarks|builders|tests|docs|config|examples|workflow)/"
ENDS = {"|", "&&", "||", ";", ">", "2>", "<", "do", "done", "then"}


def commands(text):
    """Yield the words of each command of PROGRAMS in a page's blocks and code spans."""
    for found in BLOCK.finditer(text):
        block = next(group for group in found.groups() if group is not None)
        for line in re.sub(r"\\\n\s*", " ", block).split("\n"):
            line = re.sub(r"(^|\s)#.*", "", line.strip().removeprefix("$ "))
            try:
                words = shlex.split(re.sub(r";", " ; ", line))
            except ValueError:
                continue  # a line of another language
            while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
                words = words[1:]
            while words:
                end = next((k for k, word in enumerate(words) if word in ENDS), len(words))
                if words[:end] and words[0] in PROGRAMS and len(words[:end]) > 1:
                    yield words[:end]
                words = words[end + 1 :]


def is_placeholder(word):
    return not re.search(r"[a-z]", word) or any(c in word for c in "<>$*…") or "..." in word


@cache
def options_of(script):
    """Return the option names in a script's help."""
    help_ = subprocess.run([sys.executable, script, "--help"], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", help_.stdout))


def fault(words):
    """Return what is wrong with a command, or None."""
    program, first, *rest = words
    if program == "make":
        targets = set(re.findall(r"^([\w./-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
        return None if all(word in targets or "=" in word for word in words[1:]) else "no such target"
    if program == "csstsim":
        group, context, verbs = (
            csstsim,
            click.Context(csstsim),
            [word for word in words[1:] if not word.startswith("-")],
        )
        while isinstance(group, click.Group) and verbs:
            named = group.get_command(context, verbs.pop(0))
            if named is None:
                return None if is_placeholder(first) else "no such command"
            group, context = named, click.Context(named, parent=context)
        known = {name for p in [*csstsim.params, *group.params] for name in (*p.opts, *p.secondary_opts)} | {"--help"}
        bad = [
            word
            for word in words[1:]
            if re.fullmatch(r"--?[a-z][\w-]*(=.*)?", word) and word.split("=")[0] not in known
        ]
        return f"no such option: {bad[0]}" if bad else None
    files = [
        word for word in words[1:] if re.match(r"(benchmarks|builders|tests|docs|config|examples|workflow)/", word)
    ]
    missing = [word for word in files if not is_placeholder(word) and not (ROOT / word.split("::")[0]).exists()]
    if missing:
        return f"no such file: {missing[0]}"
    if program == "python" and first.startswith("benchmarks/"):
        bad = [word for word in rest if re.fullmatch(r"--[a-z][\w-]*", word) and word not in options_of(first)]
        return f"no such option: {bad[0]}" if bad else None
    return None


def test_pages_show_commands():
    assert sum(len(list(commands(page.read_text()))) for page in PAGES) > 200


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_of_a_page_exists(page):
    faults = [f"{' '.join(words)}: {why}" for words in commands(page.read_text()) if (why := fault(words))]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("csstsim chip campaign.yaml --obsid 1 --chip 9", None), ("csstsim chop a.yaml", "no such command"),
        ("csstsim chip a.yaml --obsit 1", "no such option: --obsit"), ("make test", None),
        ("make tset", "no such target"),
        ("python benchmarks/astrometry.py", None), ("python benchmarks/astronomy.py", "no such file"),
        ("pytest tests/no_such_folder", "no such file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told(line, why):
    found = fault(shlex.split(line))
    assert found is None if why is None else found.startswith(why)
