"""An output folder belongs to one campaign, because two would overwrite each other's files.

The workflow and `csstsim chip` write `campaign.json` in it: the campaign's name, and the path of its file relative to
the folder.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from csstsim.campaign.opened import OpenCampaign

OWNER_FILE = "campaign.json"
READ_PATIENCE = 1.0  # s, after which an empty record counts as damaged: another process may be writing it


def check_owner(run: OpenCampaign) -> None:
    """Raise InputError if the output folder of an open campaign belongs to another campaign."""
    path = run.paths.output / OWNER_FILE
    try:
        owner = json.loads(_nonempty_text(path))
    except FileNotFoundError:
        return
    except NotADirectoryError:
        raise InputError("is not a folder, or is below a file", file=run.paths.output, key="output") from None
    except (OSError, ValueError):
        raise InputError("cannot be read; remove it if no other campaign uses this folder", file=path) from None
    if owner != _identity(run):
        raise InputError(
            "the folder belongs to another campaign; choose another output, or remove this file if yours was moved",
            file=path,
            value=owner,
            allowed=_identity(run),
        )


def claim_output(run: OpenCampaign) -> None:
    """Record, if this is not yet done, that the output folder belongs to the campaign.

    Raises InputError if it belongs to another campaign or cannot be written.
    """
    path = run.paths.output / OWNER_FILE
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "x") as file:  # of two at the same time only one succeeds
            json.dump(_identity(run), file, indent=1)
    except FileExistsError:
        check_owner(run)
    except OSError as exc:
        why = os.strerror(exc.errno)  # type: ignore[arg-type] # the system gives its errors a number
        raise InputError(f"cannot be written: {why}", file=path) from None
    for folder in (path.parent, *(entry for entry in path.parent.iterdir() if entry.is_dir())):
        if not os.access(folder, os.W_OK):
            raise InputError("cannot be written", file=folder)


def _nonempty_text(path: Path) -> str:
    end = time.monotonic() + READ_PATIENCE
    while not (text := path.read_text()) and time.monotonic() < end:
        time.sleep(READ_PATIENCE / 50)
    return text


def _identity(run: OpenCampaign) -> dict[str, str]:
    folder = run.paths.output.resolve()
    return {"name": run.config.name, "file": os.path.relpath(run.file.resolve(), folder)}
