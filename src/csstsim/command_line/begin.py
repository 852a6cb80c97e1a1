"""Commands of a newcomer: a folder to begin in, a look at the installation, completion in the shell."""

import sys

import click

from csstsim.command_line.completion import INSTALL
from csstsim.command_line.group import QUIET


@click.command()
@click.argument("folder", type=click.Path())
@click.option("--catalogue", type=click.Path(), help="Table of your objects (.csv, .ecsv, .fits) to point at and draw.")
def init(folder, catalogue):
    """Write a folder with a campaign that runs, for you to change.

    \b
    The shipped sky, a small field in g, r and i:
      csstsim init mysky
      cd mysky
      csstsim plan campaign.yaml
      snakemake --cores 2
    A table of your own objects, and exposures that point at them:
      csstsim init mysky --catalogue objects.csv

    Its columns: ra, dec (deg, ICRS), mag_r (AB; or any of mag_nuv to mag_y), and if you like type (star, galaxy or
    quasar), size (half-light radius, arcsec), e1, e2, z and others: `python -m pydoc csstsim.catalog.own_table`.
    """
    from csstsim.campaign.starter import init as run

    run(folder, click.echo, catalogue)


@click.command()
@click.argument("campaign", required=False, type=click.Path())
def doctor(campaign):
    """Check the installation, and a campaign if one is named.

    Prints one line for each check: ok, warning or problem, and what to do. Checked are versions, numba's cache, data,
    disk, memory, threads and optional parts. A campaign must open, and fit the disk and memory of this machine.

    \b
    For example:
      csstsim doctor
      csstsim doctor campaign.yaml

    Exit code 1 if there is a problem. With -q only warnings and problems are printed.
    """
    from csstsim.command_line.doctor import OK, PROBLEM, examine

    quiet, worst = QUIET in click.get_current_context().meta, OK
    for finding in examine(campaign):
        if finding.verdict != OK or not quiet:
            click.echo(f"{finding.verdict:<8} {finding.what}: {finding.text}")
        worst = PROBLEM if PROBLEM in (worst, finding.verdict) else OK
    if worst == PROBLEM:
        sys.exit(1)


@click.command()
@click.argument("shell", type=click.Choice(list(INSTALL)))
def completion(shell):
    """Print what makes the shell complete csstsim's commands.

    It completes commands, options, files, layers, and a campaign's exposures and chips. The first lines of the output
    say how to install it.

    \b
    For example, in this shell only:
      eval "$(csstsim completion bash)"
    To see how to install it:
      csstsim completion zsh | head
    """
    from csstsim.command_line.completion import script

    click.echo(script(shell, click.get_current_context().find_root().command))


TOOLS = init, doctor, completion
