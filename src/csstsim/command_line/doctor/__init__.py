"""Checks of an installation, and of a campaign on this machine (`csstsim doctor`).

Each check is a function that yields Findings. An exception raised by a check is reported as a problem, because
`doctor` must also work in a broken installation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.errors import CsstsimError
from csstsim.base.help_page import with_page
from csstsim.command_line.doctor.finding import PROBLEM, Finding

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator


def examine(campaign: str | None = None) -> Iterator[Finding]:
    """Yield the Findings about the installation and, if a campaign file is given, about the campaign."""
    from csstsim.command_line.doctor import installation, machine

    for check in (installation.libraries, installation.data, installation.numba_cache, machine.threads):
        yield from _safely(check)
    if campaign is None:
        yield from _safely(machine.disk_and_memory)
    else:
        from csstsim.command_line.doctor.of_campaign import of_campaign

        yield from _safely(of_campaign, campaign)


def _safely(check: Callable[..., Iterable[Finding]], *arguments: str) -> Iterator[Finding]:
    name = check.__name__.replace("_", " ").removeprefix("of ")
    try:
        yield from check(*arguments)
    except CsstsimError as error:
        yield Finding(PROBLEM, name, with_page(error))
    except Exception as error:  # what a broken library raises
        yield Finding(PROBLEM, name, f"{type(error).__name__}: {error}")
