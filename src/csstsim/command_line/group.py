"""The group of all commands: sections of the help, switches -v and -q, errors in one line, exit codes."""

from __future__ import annotations

import atexit
import gc
import logging
import os
import signal
import sys
import traceback
from contextlib import contextmanager, nullcontext, redirect_stdout
from typing import TYPE_CHECKING

import click

from csstsim.base.errors import CsstsimError
from csstsim.base.help_page import with_page
from csstsim.base.process.progress import hidden
from csstsim.base.stage_records import LOOK, ONE_CHIP, SECTION, STAGES
from csstsim.campaign.running.job_log import ERROR

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType
    from typing import Any, NoReturn


def _stages_in(section: str) -> tuple[str, ...]:
    return tuple(stage.name for stage in STAGES.values() if stage.section == section)


SECTIONS: dict[str, tuple[str, ...]] = {
    "Begin": ("init", "aim", "import-pointings", "doctor", "check", "plan", "completion"),
    ONE_CHIP: _stages_in(ONE_CHIP),
    LOOK: ("show", "status", *_stages_in(LOOK)),
    SECTION: _stages_in(SECTION),
    "Measure the simulator": ("bench", "shear", "budget"),
    "Extend": ("layers", "fit-grating", "export-grating"),
    "Deliver": ("verify", "compare", "release"),
    "Existing frames": ("place", "inject", "recover", "recreate"),
}  # fmt: skip
# New objects before a search for reference cycles; with Python's default of 700, imports cause hundreds of searches
GARBAGE_THRESHOLD = 50_000
# Keys in the meta dictionary of a command's context
VERBOSE = "csstsim.verbose"
QUIET = "csstsim.quiet"


class NotEmptyPath(click.Path):
    """The name of a file or folder; refuses an empty name, the result of an unset variable in a script."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the name. Fails for an empty one."""
        if value == "":
            self.fail("an empty name", param, ctx)
        return super().convert(value, param, ctx)


class Commands(click.Group):
    """A click group whose commands understand -v and -q after their name, and refuse empty names of files."""

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """Add a command."""
        for param in cmd.params:
            if type(param.type) is click.Path:
                param.type = NotEmptyPath()
        cmd.params += [_switch("-v", _verbose, hidden=True), _switch("-q", _quiet, hidden=True)]
        super().add_command(cmd, name)


class Group(Commands):
    """The command `csstsim`. An input error prints one line and exits with code 2; SIGTERM ends it silently."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run the command; from here on SIGTERM ends it silently."""
        signal.signal(signal.SIGTERM, _stop)
        gc.set_threshold(GARBAGE_THRESHOLD)
        atexit.register(gc.freeze)  # otherwise Python searches all imported modules at its end: half a CPU s
        return super().main(*args, **options)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, by section, each in one line."""
        for title, names in SECTIONS.items():
            width = max(map(len, names))
            rows = [
                (name.ljust(width), self.commands[name].get_short_help_str(formatter.width - width - 4))
                for name in names
            ]
            with formatter.section(title):
                formatter.write_dl(rows)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the sub-command and end with its exit code."""
        try:
            result = super().invoke(ctx)
            if sys.stdout:  # None if closed before the start
                sys.stdout.flush()  # its errors could not be caught at exit
            return result
        except BrokenPipeError:
            _discard_output()
            sys.exit(128 + signal.SIGPIPE)
        except CsstsimError as error:
            if VERBOSE in ctx.meta:
                traceback.print_exception(error)
            message = with_page(error)
        except OSError as error:  # an output folder that is a file or read-only, a full disk
            if error.filename is None and error.errno is None:
                raise
            message = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
        click.echo(f"{ERROR} {message}", err=True)
        sys.exit(2)


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    """Exit by an exception, so that half-written files are removed (csstsim.base.files.atomic)."""
    sys.exit(128 + number)


def _discard_output() -> None:
    """Redirect standard output to the null device, so that buffered text causes no error at exit."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)


def _switch(
    letter: str, callback: Callable[[click.Context, click.Parameter, bool], None], **options: Any
) -> click.Option:
    name = {"-v": "--verbose", "-q": "--quiet"}[letter]
    return click.Option([letter, name], is_flag=True, expose_value=False, callback=callback, **options)


def _verbose(ctx: click.Context, option: click.Parameter, value: bool) -> None:
    """Begin -v: until the command ends, log on standard error which files are read and written."""
    if value and VERBOSE not in ctx.meta:
        ctx.meta[VERBOSE] = True
        ctx.find_root().with_resource(_files_logged())
        ctx.find_root().with_resource(hidden())  # log lines and progress bars would mix


def _quiet(ctx: click.Context, option: click.Parameter, value: bool) -> None:
    """Begin -q: no progress bars; `quiet_output` discards what a command prints."""
    if value and QUIET not in ctx.meta:
        ctx.meta[QUIET] = sys.stdout
        ctx.find_root().with_resource(hidden())


SWITCHES = [
    _switch("-v", _verbose, help="Log each file that is read or written, with the time; show tracebacks of errors."),
    _switch("-q", _quiet, help="Print only errors and the requested result."),
]


@contextmanager
def _files_logged() -> Iterator[None]:
    log = logging.getLogger("csstsim.files")
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("csstsim: %(asctime)s.%(msecs)03d %(message)s", "%H:%M:%S"))
    log.addHandler(handler)
    log.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        log.setLevel(logging.NOTSET)
        log.removeHandler(handler)


@contextmanager
def quiet_output() -> Iterator[None]:
    """Under -q, discard what is printed inside."""
    quiet = QUIET in click.get_current_context().meta
    with open(os.devnull, "w") as null, redirect_stdout(null) if quiet else nullcontext():
        yield


def print_result(text: str) -> None:
    """Print the requested result of a command, also under -q."""
    print(text, file=click.get_current_context().meta.get(QUIET))
