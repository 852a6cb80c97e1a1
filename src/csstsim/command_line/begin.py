"""Commands of a newcomer: a folder to begin in, a look at the installation, completion in the shell."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from csstsim.command_line.completion import INSTALL
from csstsim.command_line.group import QUIET

if TYPE_CHECKING:
    from typing import Any


@click.command()
@click.argument("folder", type=click.Path())
@click.option("--catalogue", type=click.Path(), help="Table of your objects (.csv, .ecsv, .fits) to point at and draw.")
@click.option(
    "--example", type=click.Choice(["layer", "catalogue", "camera", "shear", "slitless", "lens"]), help="An example."
)
def init(folder: str, catalogue: str | None, example: str | None) -> None:
    """Write a folder with a campaign that runs, yours to change.

    \b
    The shipped sky, a small field in g, r and i:
      csstsim init mysky
      cd mysky
      csstsim plan campaign.yaml
      snakemake --cores 2
    A table of your own objects, and exposures that point at them:
      csstsim init mysky --catalogue objects.csv
    A worked example: a layer, catalogue class or camera of your own, shear twins, a slitless spectrum, a strong lens:
      csstsim init mylab --example layer

    Its columns: ra, dec (deg, ICRS), mag_r (AB; or any of mag_nuv to mag_y), and if you like type (star, galaxy or
    quasar), size (half-light radius, arcsec), e1, e2, z and others. README.md of the example `catalogue` lists all.
    """
    from csstsim.campaign.starter import init as run

    if catalogue and example:
        raise click.UsageError("--catalogue and --example exclude each other")
    run(folder, click.echo, catalogue, example)


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("ra", type=float)
@click.argument("dec", type=float)
@click.option("--chip", "chips", type=int, multiple=True, help="Chip to aim at; repeat for more [default: 9].")
@click.option("--filter", "filters", multiple=True, help="... or a filter, behind its innermost chip; repeat for more.")
@click.option("--pa", type=float, default=0.0, show_default=True, help="Position angle of the camera, deg.")
@click.option(
    "--dither",
    "shifts",
    nargs=2,
    type=float,
    multiple=True,
    metavar="DX DY",
    help="Target's shift along the chip's x and y, arcsec; repeat for one exposure each [default: 0 0].",
)
@click.option("--time", "times", multiple=True, help="Start, ISO UTC; repeat for more epochs.")
@click.option("--exptime", type=float, default=150.0, show_default=True, help="Exposure time, s.")
@click.option("--obsid", default="10100000001", show_default=True, help="Number of the first exposure.")
@click.option("--instrument", type=click.Path(), help="Folder of the camera [default: the shipped one].")
@click.option("--output", type=click.Path(), help="New file for the table [default: print it].")
def aim(ra: float, dec: float, output: str | None, instrument: str | None, **values: Any) -> None:
    """Write exposures of one place as a survey table.

    RA and DEC are in deg, ICRS. The ra and dec of a survey table's row are the direction of the focal plane's middle.
    `aim` finds the one that puts your place on the middle of a chip. On a chip behind gratings, the middle of the
    zeroth and the first order falls on the middle of the wider grating.

    \b
    An r image:
      csstsim aim 150.1 2.2
    Three bands, two dithered exposures each, in a file:
      csstsim aim 150.1 2.2 --filter g --filter r --filter i --dither 0 0 --dither 10 5 --output table.csv
    An image and a spectrum:
      csstsim aim 150.1 -2.2 --filter r --filter GI
    """
    from csstsim.base.shipped import SHIPPED
    from csstsim.campaign.aiming import aim as run

    run(ra, dec, click.echo, output=output, instrument=instrument or SHIPPED / "instrument", **values)


@click.command("import-pointings")
@click.argument("file", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="New file for the survey table.")
@click.option("--map", "maps", multiple=True, metavar="KEY=COLUMN", help="Column of the list for a quantity; repeat.")
@click.option("--set", "sets", multiple=True, metavar="KEY=VALUE", help="Value of a quantity in all rows; repeat.")
@click.option("--like", metavar="LIST", help="Map as for a known list: csst, opsim.")
@click.option("--mapping", type=click.Path(), help="Map as in this file, which an earlier import has written.")
@click.option("--pa-sense", type=click.Choice(["east", "west"]), help="Angles run from north to here [default: east].")
@click.option("--pa-zero", type=float, help="Position angle (through east) of the list's angle 0, deg [default: 0].")
@click.option(
    "--pa-north", type=click.Choice(["equator", "ecliptic", "galactic"]), help="Whose north [default: equator]."
)
@click.option(
    "--directions",
    type=click.Choice(["apparent", "icrs"]),
    help="What directions are; aberration is added to icrs [default: apparent].",
)
@click.option("--first-obsid", help="obsid of the list's number 0, or of its first row [default: 10100000001].")
@click.option("--tolerance", type=float, help="Largest difference from what the list states, deg [default: 1].")
def import_pointings(file: str, output: str, **options: Any) -> None:
    """Make a survey table of another's list of pointings.

    FILE is CSV, ECSV, FITS or columns between blanks. A text without names has columns col1, col2, ...; in any list,
    colN is the N-th. A column that is called as its KEY needs no --map.

    \b
    KEY is a quantity, then its unit if it is not the first here:
      ra dec, or ecl_lon ecl_lat, or gal_lon gal_lat      _deg _hour _rad _arcmin _arcsec _hms _dms
      pa (of the focal plane's +y), sun_angle, moon_angle the same
      time (start of the exposure)                        _iso _jd _mjd _unix; then _utc _tai _tt _tdb
      exptime                                             _s _ms _min _hour _day
      sat_x sat_y sat_z (geocentric GCRS)                 _km _m _au
      sat_vx sat_vy sat_vz                                _km_s _m_s
      sun_x sun_y sun_z, moon_x moon_y moon_z             _km _m _au
      obsid, number (is added to --first-obsid), type, deep (yes or no), deep_index (-1 is wide)

    A FITS or ECSV file's own unit counts, and a unit at the end of a column's name (start_mjd). Two that differ are
    an error.

    \b
    A CSV list with RA in hours, DEC, MJD and exptime:
      csstsim import-pointings plan.csv --map ra_hour=RA --map dec=DEC --map time_mjd=MJD --set pa=0 --output table.csv
    A simulation of the Rubin scheduler; the CSST strategy list:
      csstsim import-pointings visits.csv --like opsim --output table.csv
      csstsim import-pointings strategy.dat --like csst --output table.csv
    Another list of the same form, by the mapping that was kept:
      csstsim import-pointings next.csv --mapping table.mapping.yaml --output next_table.csv

    Sun, Moon and a second direction are compared with what csstsim computes. Rejected rows are in
    TABLE.rejected.csv, each with its reason. Exit codes: 0 all rows imported, 1 some rejected, 2 nothing imported.
    """
    from csstsim.campaign.pointing_lists.import_pointings import import_pointings as run

    if run(file, output, click.echo, **options):
        sys.exit(1)


@click.command()
@click.argument("campaign", required=False, type=click.Path())
def doctor(campaign: str | None) -> None:
    """Check the installation, and a campaign if one is named.

    Prints one line for each check: ok, warning or problem, and what to do. Checked are versions, numba's cache, data,
    disk, memory and threads. A campaign must open, and fit the disk and memory of this machine.

    \b
    For example:
      csstsim doctor
      csstsim doctor campaign.yaml

    Exit code 1 if there is a problem. With -q only warnings and problems are printed.
    """
    from csstsim.command_line.doctor import OK, PROBLEM, examine

    quiet = QUIET in click.get_current_context().meta
    worst = OK
    for finding in examine(campaign):
        if finding.verdict != OK or not quiet:
            click.echo(f"{finding.verdict:<8} {finding.what}: {finding.text}")
        worst = PROBLEM if PROBLEM in (worst, finding.verdict) else OK
    if worst == PROBLEM:
        sys.exit(1)


@click.command()
@click.argument("shell", type=click.Choice(list(INSTALL)))
def completion(shell: str) -> None:
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


TOOLS = init, aim, import_pointings, doctor, completion
