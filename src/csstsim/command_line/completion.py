"""Shell completion: after `--obsid` and `--chip` the Tab key lists the exposures and chips of the campaign.

It must be fast. So only the readers of the campaign file and the survey table are imported, and nothing is checked.
A file that cannot be read gives an empty list.
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
    """Return the obsids that begin with `incomplete`, of the campaign named earlier on the line."""
    campaign = _campaign(ctx)
    select = campaign.get("select") or {}
    obsids = []
    try:
        lines = read_text(_path_of(ctx, campaign.get("survey_table"))).splitlines()  # refuses a pipe, which may not end
        for row in csv.DictReader(line for line in lines if not line.lstrip().startswith("#")):
            obsid, kind = (row.get(name) or "" for name in ("obsid", "type"))
            selected = kind in select.get("types", [kind]) and obsid in map(str, select.get("obsids") or [obsid])
            if selected and obsid.startswith(incomplete):
                obsids.append(obsid)
    except (InputError, ValueError, TypeError, AttributeError, csv.Error):  # also of a campaign with wrong types
        return []
    return obsids


def chips_of(ctx: Context, param: Parameter, incomplete: str) -> list[str]:
    """Return the chip numbers that begin with `incomplete`, of select.chips if it is a list, else of the camera."""
    select = _campaign(ctx).get("select")
    chips = select.get("chips") if isinstance(select, dict) else None
    listed = [chip for chip in chips if isinstance(chip, int)] if isinstance(chips, list) else _all_chips(ctx)
    return [str(chip) for chip in listed if str(chip).startswith(incomplete)]


def _all_chips(ctx: Context) -> list[int]:
    """Return the numbers of all chips of the campaign's camera."""
    from csstsim.base.files.yaml_file import read_yaml
    from csstsim.base.shipped import SHIPPED

    instrument = _campaign(ctx).get("instrument")
    name = instrument.get("folder") if isinstance(instrument, dict) else instrument
    folder = _path_of(ctx, name) if name else SHIPPED / "instrument"
    try:
        rows = read_yaml(folder / "chips.yaml")["chips"]["values"]
        return sorted(row["id"] for row in rows)
    except (InputError, KeyError, TypeError):
        return []


def layers_of(ctx: Context, param: Parameter, incomplete: str) -> list[str]:
    """Return the keywords, in lower case, of csstsim's layers that begin with `incomplete`."""
    from csstsim.simulation.sim_steps import known_layers

    return [name for name in known_layers() if name.startswith(incomplete.lower())]


def _file(ctx: Context) -> str | None:
    return ctx.params.get("campaign") or next(iter(ctx.args), None)  # click stops at the option that has no value yet


def _path_of(ctx: Context, path: object) -> Path:
    """Return a path that the campaign file names, relative to the folder of that file."""
    return Path(_file(ctx) or "").parent / str(path)


def _campaign(ctx: Context) -> dict[str, Any]:
    """Return the content of the campaign file, unchecked; {} without a readable file."""
    from csstsim.base.files.yaml_file import read_yaml

    file = _file(ctx)
    try:
        return read_yaml(file) if file else {}
    except InputError:
        return {}


def script(shell: str, command: Command) -> str:
    """Return the shell code that completes the click `command`, with a comment on how to install it."""
    from click.shell_completion import get_completion_class

    completion_class = cast("type[ShellComplete]", get_completion_class(shell))  # click has all shells of INSTALL
    completion = completion_class(command, {}, "csstsim", "_CSSTSIM_COMPLETE")
    return f"# To install it:\n#   {INSTALL[shell]}\n{completion.source()}"
