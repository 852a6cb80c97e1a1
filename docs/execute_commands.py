"""Execute what pages show: python docs/execute_commands.py [PAGE]...      default: all; some minutes.

The commands and the Python of a page run in order, in one folder, and stop at the first error. The folder is empty, or
a copy of the repository in which the demo and the calibration frames are small. docs/commands_of_pages.yaml tells what
to make before, what stands for a page's placeholders, and which lines other suites execute.
"""

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = Path(__file__).with_name("commands_of_pages.yaml")
PAGES = ("README.md", "CONTRIBUTING.md", "docs/*.md", "*/README.md", "examples/*/README.md")
PROGRAMS = ("csstsim ", "snakemake ", "python ", "make ", "pytest ", "pip ", "git ", "cd ", "for ", "cp ")
BLOCK = re.compile(r"(?ms)^```([^\n]*)\n(.*?)^```|^((?: {4}[^\n]*\n)+)")
REMARK = re.compile(r"(?m)^(\S.*?\S) {3,}[^-\s].*$|\s+#.*$")  # behind a command
TAIL = 30  # lines shown of what failed


def blocks(page: Path) -> list[tuple[str, str]]:
    """Return (language, text) of a page's fences and indented lines; those that are commands have the language sh."""
    found = []
    for fence in BLOCK.finditer(page.read_text()):
        language, text = ("", re.sub(r"(?m)^ {4}", "", fence[3])) if fence[3] else (fence[1], fence[2])
        shell = language in ("sh", "bash") or (not language and text.strip().startswith(PROGRAMS))
        found.append(("sh" if shell else language, text))
    return found


def lacking(code: str) -> list[str]:
    """Return the modules that code imports and that are not installed."""
    names = re.findall(r"(?m)^(?:import|from) (\w+)", code)
    return [name for name in names if importlib.util.find_spec(name) is None]


def script(page: Path, entry: dict, elsewhere: Iterable[str], folder: Path) -> str:
    """Return the shell script of a page; its Python and the files that it shows go to the folder."""
    lines, file, whole = [], folder, tuple(elsewhere)
    shown = blocks(page)
    for name, begin in entry.get("files", {}).items():
        (text,) = (text for _, text in shown if text.startswith(begin))
        (folder / name).write_text(text)
    for language, text in shown:
        for old, new in entry.get("replace", {}).items():
            text = text.replace(old, new)
        if language == "python" and (names := lacking(text)):
            print(f"skipped  a block of {page.name}: {', '.join(names)} is not installed")
        elif language == "python":
            if not (lines and lines[-1].startswith("python $SHOWN/block_")):  # else it goes on with the block before
                file = folder / f"block_{len(lines)}.py"
                file.write_text(entry.get("python", ""))
                lines.append(f"python $SHOWN/{file.name}\n")
            with file.open("a") as block:
                block.write(f"\n{text}")
        elif language == "sh":
            kept = REMARK.sub(r"\1", text).split("\n")
            starts = tuple(start for start in whole if start.endswith((" ", "/")))
            lines += [
                f"{line}\n" for line in kept if line.strip() and line not in whole and not line.startswith(starts)
            ]
    return "".join([f"{entry['before']}\n" if "before" in entry and lines else "", *lines])


def copy(to: Path, small: dict[str, dict[str, str]]) -> None:
    """Copy the repository's files; write small what is too large to execute."""
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in names.splitlines():
        if (ROOT / name).exists() and not name.startswith(("docs/figures", "tests")):
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, to / name)
    for name, changes in small.items():
        text = (to / name).read_text()
        for old, new in changes.items():
            if old not in text:
                raise SystemExit(f"{SETTINGS.name}: {name} has no {old!r}")
            text = text.replace(old, new)
        (to / name).write_text(text)


def main() -> int:
    """Execute the pages asked for; return the exit code."""
    settings = yaml.safe_load(SETTINGS.read_text())
    pages = {str(path.relative_to(ROOT)): path for pattern in PAGES for path in sorted(ROOT.glob(pattern))}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *pages], metavar="PAGE")
    parser.add_argument("--folder", type=Path, help="an empty folder for what is made, which stays; default: removed")
    asked = parser.parse_args()
    if gone := settings["pages"].keys() - pages.keys():
        parser.error(f"{SETTINGS.name} has pages that are gone: {', '.join(sorted(gone))}")
    failed = []
    with tempfile.TemporaryDirectory(prefix="pages_") as temporary:
        made = (asked.folder or Path(temporary)).resolve()
        clone = made / "clone"
        copy(clone, settings["small"])
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "CLONE": str(clone)}
        for name in asked.names or pages:
            entry = settings["pages"].get(name, {})
            if "skip" in entry:
                print(f"skipped  {name}: {entry['skip']}")
                continue
            folder = made / name.replace("/", "_").removesuffix(".md")
            folder.mkdir(parents=True, exist_ok=True)
            text = script(pages[name], entry, settings["elsewhere"] | entry.get("elsewhere", {}), folder)
            if not text:
                continue
            start = time.monotonic()
            where = clone if entry.get("where") == "clone" else folder
            environment["SHOWN"] = str(folder)
            run = subprocess.run(
                ["bash", "-ex"], input=text, cwd=where, env=environment, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            )  # fmt: skip
            verdict = "FAILED" if run.returncode else "ok"
            print(f"{verdict:8} {name}: {time.monotonic() - start:.0f} s, {text.count(chr(10))} lines", flush=True)
            if run.returncode:
                failed.append(name)
                print("    " + "\n    ".join(run.stdout.splitlines()[-TAIL:]), flush=True)
    print(f"failed: {', '.join(failed)}" if failed else "What the pages show was executed")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
