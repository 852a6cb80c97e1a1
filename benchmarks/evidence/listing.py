"""The page of all commands: age, verdict, cost and figures of each, for docs/evidence.md.

The page is made when the site is built, because whether a record is stale depends on the tree.
"""

import datetime

from evidence.commands import Command, commands
from evidence.pages import anchor, record, shown, used
from evidence.record import FAIL, PASS
from evidence.renewal import stale_parts

MARK = "<!-- all commands -->"


def state(command: Command) -> tuple[str, list[str]]:
    """Return "current", "stale" or "never recorded", and the parts that changed since it was made or renewed."""
    content = record(command.name)
    if content is None:
        return "never recorded", []
    parts = stale_parts(command, content)
    return ("stale" if parts else "current"), parts


def verdict(content: dict | None) -> str:
    """Return "fail" if a goal is missed, "pass" if all are met, and nothing if there is none."""
    verdicts = {value.get("verdict", "") for value in content["values"].values()} if content else set()
    return FAIL if FAIL in verdicts else PASS if PASS in verdicts else ""


def _section(command: Command, pages: list[str]) -> list[str]:
    content = record(command.name)
    parts = state(command)[1]
    lines = [f"### {command.name}", "", f"{command.what[0].upper()}{command.what[1:]}.", "", f"    {command.full}", ""]
    needs = [*command.modules, *command.programs, *(f"{name} ({what})" for name, what in command.folders.items())]
    if needs:
        lines += [f"It needs {', '.join(needs)}.", ""]
    if command.after:
        lines += [f"Run first: {', '.join(f'[{name}](#{anchor(name)})' for name in command.after)}.", ""]
    if content:
        lines += [
            f"Measured {content['date']} on commit `{content['commit']}`, in {content['cpu_seconds']:,.0f} CPU-s, on "
            f"{content['machine']}.",
            "",
        ]
        if renewed := content.get("renewed"):
            lines += [f"At toy size the same values on commit `{renewed['commit']}`, {renewed['date']}.", ""]
    if parts:
        lines += [f"Stale: changed since are {', '.join(f'`{part}`' for part in parts[:8])}"
                  f"{f' and {len(parts) - 8} more' if len(parts) > 8 else ''}.", ""]  # fmt: skip
    elif content is None:
        lines += ["Never recorded.", ""]
    if pages:
        lines += [f"Shown on {', '.join(f'`{page}`' for page in pages)}.", ""]
    if content and content["values"]:
        lines += ["| figure | value | goal |", "|---|---|---|"]
        for value in content["values"].values():
            number = f"{value['value']:.4g}" if isinstance(value["value"], float) else str(value["value"])
            error = f" ± {value['error']:.2g}" if "error" in value else ""
            goal = f"{value['goal']}: {value['verdict']}" if "goal" in value else ""
            what = value["what"].replace("|", "\\|")
            lines.append(f"| {what} | {number}{error} {value.get('unit', '')} | {goal} |")
        lines.append("")
    for name, table in content["tables"].items() if content else ():
        lines += [f"`{name}`:", "", shown(table), ""]
    return lines


def listing() -> str:
    """Return the Markdown of the page: totals, a line a command, then a section a command."""
    known = commands()
    contents = {name: record(name) for name in known}
    states = {name: state(command)[0] for name, command in known.items()}
    made = [content for content in contents.values() if content]
    rows = sum(table.count("\n") - 1 for content in made for table in content["tables"].values())
    count = rows + sum(len(content["values"]) for content in made)
    hours = sum(content["cpu_seconds"] for content in made) / 3600
    kinds = {name: sum(how == name for how in states.values()) for name in ("current", "stale", "never recorded")}
    failed = sum(verdict(content) == FAIL for content in made)
    lines = [
        f"{len(known)} commands, {count:,} values and rows of tables, {hours:.1f} CPU-hours. {kinds['current']} "
        f"records are current, {kinds['stale']} stale; {kinds['never recorded']} commands were never recorded. "
        f"{failed} miss a goal.",
        "",
        "| command | measured | age [days] | CPU-s | record | goals |",
        "|---|---|---|---|---|---|",
    ]
    for name, content in contents.items():
        age = (datetime.date.today() - datetime.date.fromisoformat(str(content["date"]))).days if content else ""
        when, cost = (content["date"], f"{content['cpu_seconds']:,.0f}") if content else ("", "")
        lines.append(f"| [{name}](#{anchor(name)}) | {when} | {age} | {cost} | {states[name]} | {verdict(content)} |")
    pages = used()
    sections = [line for command in known.values() for line in _section(command, pages.get(command.name, []))]
    return "\n".join([*lines, "", "## Each command", "", *sections])
