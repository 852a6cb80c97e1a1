"""Arguments and options that commands share: campaign, exposure, chip, brick; the first and last line of a log."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import click

from csstsim.base.errors import InputError
from csstsim.base.old_names import old_name
from csstsim.base.process.progress import progress
from csstsim.campaign.running.job_log import job_log, part_log
from csstsim.command_line.completion import chips_of, obsids_of
from csstsim.command_line.group import quiet_output

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from csstsim.campaign.opened import OpenCampaign


class Finite(click.FloatRange):
    """A number that is neither NaN nor infinite."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number. Fails for anything else."""
        value = super().convert(value, param, ctx)
        if not math.isfinite(value):
            self.fail(f"{value} is not a finite number", param, ctx)
        return value


class Renamed(click.Command):
    """A command whose options had other spellings: they still work, with a warning, and are not in the help."""

    def __init__(self, *args: Any, old: dict[str, str], goes: str, **options: Any) -> None:
        """old: {earlier spelling: spelling}; goes: the first version without the earlier ones."""
        super().__init__(*args, **options)
        self.old = old
        self.goes = goes

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words of the command line."""
        return super().parse_args(ctx, [self._spelling(word) for word in args])

    def _spelling(self, word: str) -> str:
        name, equals, value = word.partition("=")
        if name not in self.old:
            return word
        click.echo(f"warning: {old_name(f'{name} is now {self.old[name]}', self.goes)}", err=True)
        return self.old[name] + equals + value


campaign_arg = click.argument("campaign", type=click.Path())
obsid_opt = click.option(
    "--obsid", required=True, shell_complete=obsids_of, help="Obsid of the exposure, as in the survey table."
)
chip_opt = click.option(
    "--chip",
    "chip_id",
    required=True,
    type=click.IntRange(1),
    shell_complete=chips_of,
    help="Chip number.",
)
brick_opt = click.option(
    "--brick", "pix", required=True, type=click.IntRange(0, 786431), help="HEALPix pixel of NSIDE 256, nested."
)


def _once(context: click.Context, option: click.Parameter, numbers: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(dict.fromkeys(numbers))


chips_opt = click.option(
    "--chip",
    "chip_ids",
    required=True,
    multiple=True,
    type=click.IntRange(1),
    callback=_once,
    shell_complete=chips_of,
    help="Chip number; may be repeated.",
)
resume_opt = click.option(
    "--resume", is_flag=True, help="Skip the chips that an earlier run with --resume has finished."
)
bricks_opt = click.option(
    "--brick",
    "bricks",
    required=True,
    multiple=True,
    type=click.IntRange(0, 786431),
    callback=_once,
    help="HEALPix pixel of NSIDE 256, nested; may be repeated.",
)
scratch_opt = click.option(
    "--scratch",
    type=click.Path(),
    envvar="CSSTSIM_SCRATCH",
    help="Folder of a chip's intermediate files [default: $CSSTSIM_SCRATCH, or the campaign's output folder].",
)


def of_campaign(function: Callable[..., object]) -> Callable[..., object]:
    """Replace a command's argument CAMPAIGN by the opened campaign; import the campaign code only when it runs."""

    @functools.wraps(function)
    def command(campaign: str, **options: Any) -> object:
        from csstsim.campaign.opened import OpenCampaign

        folders = options.pop("output", None), options.pop("scratch", None)
        chips: tuple[Any, ...] = options.get("chip_ids") or (options.get("chip_id"),)
        only = (options["obsid"], chips) if "obsid" in options and chips != (None,) else None
        return function(OpenCampaign(campaign, *folders, only=only), **options)

    return campaign_arg(command)


def stage(function: Callable[..., object]) -> Callable[..., object]:
    """As of_campaign, for commands that write products: the log begins with the job and ends with its cost."""

    @functools.wraps(function)
    def logged(run: OpenCampaign, **options: Any) -> object:
        names = {"obsid": "exposure", "chip_id": "chip", "chip_ids": "chip", "pix": "brick", "bricks": "brick"}
        given = [(word, options[key]) for key, word in names.items() if key in options]
        groups = [(word, *(value if isinstance(value, tuple) else (value,))) for word, value in given]
        job = " ".join(str(part) for group in groups for part in group)
        verb = click.get_current_context().info_name
        with quiet_output(), job_log(verb, run.config.name, run.config.digest(), job):
            return function(run, **options)

    return of_campaign(logged)


def of_job(function: Callable[..., object]) -> Callable[..., object]:
    """As stage, for one chip of one exposure: the function gets a job."""

    def command(run: OpenCampaign, obsid: str, chip_id: int, **options: Any) -> object:
        job = run.job(obsid, chip_id)
        with job.named():
            return function(run, job, **options)

    return obsid_opt(chip_opt(stage(functools.update_wrapper(command, function))))


def of_exposure(function: Callable[..., object]) -> Callable[..., object]:
    """As stage, for all chips of one science exposure: the function gets its obsid."""

    def command(run: OpenCampaign, obsid: str, **options: Any) -> object:
        if obsid not in run.science_exposures:
            message, allowed = "not a science exposure of this campaign", ", ".join([*run.science_exposures][:3])
            raise InputError(message, file=run.file, key="obsid", value=obsid, allowed=allowed)
        return function(run, obsid, **options)

    return obsid_opt(stage(functools.update_wrapper(command, function)))


def of_jobs(function: Callable[..., object]) -> Callable[..., object]:
    """As stage, for chips of one exposure: the function gets a list of jobs."""

    def command(run: OpenCampaign, obsid: str, chip_ids: tuple[int, ...], **options: Any) -> object:
        return function(run, [run.job(obsid, chip_id) for chip_id in chip_ids], **options)

    return obsid_opt(chips_opt(resume_opt(stage(functools.update_wrapper(command, function)))))


def of_bricks(function: Callable[..., object]) -> Callable[..., object]:
    """As stage, for bricks, one after the other: the function gets a brick at a time."""

    def command(run: OpenCampaign, bricks: tuple[int, ...], **options: Any) -> None:
        for pix in progress(bricks, "bricks"):
            with part_log("brick", pix):
                function(run, pix, **options)

    return bricks_opt(stage(functools.update_wrapper(command, function)))
