"""Completion at the Tab key: after `--obsid` and `--chip` the shell offers the campaign's exposures and chips.

The shell waits for the answer. So only the readers of the two files are imported, nothing is checked, and a file that
cannot be read offers nothing.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, cast

from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_text

if TYPE_CHECKING:
    from typing import Any

    from click import Command, Context, Parameter
    from click.shell_completion import ShellComplete

INSTALL = {
    "bash": 'eval "$(csstsim completion bash)"    # at the end of ~/.bashrc; bash 4.4 or newer',
    "zsh": 'eval "$(csstsim completion zsh)"     # at the end of ~/.zshrc',
    "fish": "csstsim completion fish > ~/.config/fish/completions/csstsim.fish    # once",
}


def obsids_of(ctx: Context, param: Parameter, incomplete: str) -> list[str]:
    """Return the exposures of the campaign named before on the line that begin with `incomplete`."""
    campaign = _campaign(ctx)
    select = campaign.get("select") or {}
    found = []
    try:
        lines = read_text(_beside(ctx, campaign.get("survey_table"))).splitlines()  # of a file: a pipe would never end
        for row in csv.DictReader(line for line in lines if not line.lstrip().startswith("#")):
            obsid, kind = (row.get(name) or "" for name in ("obsid", "type"))
            wanted = kind in select.get("types", [kind]) and obsid in map(str, select.get("obsids") or [obsid])
            if wanted and obsid.startswith(incomplete):
                found.append(obsid)
    except (InputError, ValueError, TypeError, AttributeError, csv.Error):  # a campaign of the wrong form, too
        return []
    return found


def chips_of(ctx: Context, param: Parameter, incomplete: str) -> list[str]:
    """Return the numbers of the chips that the campaign lists, or of all, that begin with `incomplete`."""
    select = _campaign(ctx).get("select")
    chips = select.get("chips") if isinstance(select, dict) else None
    listed = [chip for chip in chips if isinstance(chip, int)] if isinstance(chips, list) else _all_chips(ctx)
    return [str(chip) for chip in listed if str(chip).startswith(incomplete)]


def _all_chips(ctx: Context) -> list[int]:
    """Return the numbers of all chips of the campaign's camera."""
    from csstsim.base.files.yaml_file import read_yaml
    from csstsim.base.shipped import SHIPPED

    given = _campaign(ctx).get("instrument")
    given = given.get("folder") if isinstance(given, dict) else given
    folder = _beside(ctx, given) if given else SHIPPED / "instrument"
    try:
        rows = read_yaml(folder / "chips.yaml")["chips"]["values"]
        return sorted(row["id"] for row in rows)
    except (InputError, KeyError, TypeError):
        return []


def layers_of(ctx: Context, param: Parameter, incomplete: str) -> list[str]:
    """Return the keywords of csstsim's layers that begin with `incomplete`, in small letters."""
    from csstsim.simulation.sim_steps import known_layers

    return [name for name in known_layers() if name.startswith(incomplete.lower())]


def _file(ctx: Context) -> str | None:
    return ctx.params.get("campaign") or next(iter(ctx.args), None)  # click stops at the option that has no value yet


def _beside(ctx: Context, path: object) -> Path:
    """Return a path of the campaign, relative to its file."""
    return Path(_file(ctx) or "").parent / str(path)


def _campaign(ctx: Context) -> dict[str, Any]:
    """Return the campaign's file as a mapping, unchecked; an empty one if there is none."""
    from csstsim.base.files.yaml_file import read_yaml

    file = _file(ctx)
    try:
        return read_yaml(file) if file else {}
    except InputError:
        return {}


def script(shell: str, command: Command) -> str:
    """Return the shell code that completes the click `command`; a comment in it says how to install it."""
    from click.shell_completion import get_completion_class

    kind = cast("type[ShellComplete]", get_completion_class(shell))  # click knows all of INSTALL
    complete = kind(command, {}, "csstsim", "_CSSTSIM_COMPLETE")
    return f"# To install it:\n#   {INSTALL[shell]}\n{complete.source()}"
