"""Commands to begin with: a first campaign, survey tables, checks of the installation, shell completion."""

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
@click.option("--catalogue", type=click.Path(), help="Table of your objects (.csv, .ecsv, .fits) to observe.")
@click.option(
    "--example",
    type=click.Choice(["layer", "catalogue", "camera", "shear", "slitless", "lens"]),
    help="Write this example instead of the default campaign.",
)
def init(folder: str, catalogue: str | None, example: str | None) -> None:
    """Write a folder with a campaign that runs as it is.

    \b
    The simulated sky that comes with csstsim, a small field in g, r and i:
      csstsim init mysky
      cd mysky
      csstsim plan campaign.yaml
      snakemake --cores 2
    A table of your own objects, and exposures centred on them:
      csstsim init mysky --catalogue objects.csv
    A worked example: a layer, catalogue class or camera of your own, shear twins, a slitless spectrum, a strong lens:
      csstsim init mylab --example layer

    The table needs the columns ra, dec (deg, ICRS) and mag_r (AB; or any of mag_nuv to mag_y). Optional columns are
    type (star, galaxy or quasar), size (half-light radius, arcsec), e1, e2, z and others. README.md of the example
    `catalogue` lists all columns.
    """
    from csstsim.campaign.starter import init as run

    if catalogue and example:
        raise click.UsageError("--catalogue and --example exclude each other")
    run(folder, click.echo, catalogue, example)


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("ra", type=float)
@click.argument("dec", type=float)
@click.option(
    "--chip", "chips", type=int, multiple=True, help="Chip that the position falls on; may be repeated [default: 9]."
)
@click.option(
    "--filter",
    "filters",
    multiple=True,
    help="Filter; its chip nearest to the boresight is used; may be repeated.",
)
@click.option(
    "--pa",
    type=float,
    default=0.0,
    show_default=True,
    help="Position angle of the focal plane's +y axis, north through east, deg.",
)
@click.option(
    "--dither",
    "shifts",
    nargs=2,
    type=float,
    multiple=True,
    metavar="DX DY",
    help="Shift of the target along the chip's x and y, arcsec; repeat for more exposures [default: 0 0].",
)
@click.option(
    "--time",
    "times",
    multiple=True,
    help="Start of an exposure, ISO UTC; repeat for more epochs [default: 2027-11-20T01:20:00].",
)
@click.option("--exptime", type=float, default=150.0, show_default=True, help="Exposure time, s.")
@click.option("--obsid", default="10100000001", show_default=True, help="Obsid of the first exposure, 9 to 14 digits.")
@click.option("--instrument", type=click.Path(), help="Folder of the camera [default: the shipped one].")
@click.option("--output", type=click.Path(), help="New file for the table [default: print the table].")
def aim(ra: float, dec: float, output: str | None, instrument: str | None, **values: Any) -> None:
    """Write a survey table of exposures of one position.

    RA and DEC are the position in deg, ICRS. In a survey table, ra and dec are the direction of the boresight, the
    centre of the focal plane. `aim` computes the boresight for which the position falls on the centre of a chip. On a
    chip behind gratings, the midpoint of the zeroth and first orders falls on the centre of the wider grating. A
    warning says that the Sun is too near or the Earth in the way: choose another --time.

    \b
    An r-band image:
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
@click.option("--map", "maps", multiple=True, metavar="KEY=COLUMN", help="Column with a quantity; may be repeated.")
@click.option(
    "--set", "sets", multiple=True, metavar="KEY=VALUE", help="Value of a quantity for all rows; may be repeated."
)
@click.option("--like", metavar="LIST", help="Use the mapping of a known list: csst, opsim.")
@click.option("--mapping", type=click.Path(), help="Use the mapping file that an earlier import wrote.")
@click.option(
    "--pa-sense",
    type=click.Choice(["east", "west"]),
    help="Sense of the list's position angles, from north [default: east].",
)
@click.option("--pa-zero", type=float, help="Position angle (through east) of the list's angle 0, deg [default: 0].")
@click.option(
    "--pa-north",
    type=click.Choice(["equator", "ecliptic", "galactic"]),
    help="Frame whose north pole the angles refer to [default: equator].",
)
@click.option(
    "--directions",
    type=click.Choice(["apparent", "icrs"]),
    help="Kind of the list's directions; aberration is added to icrs [default: apparent].",
)
@click.option("--first-obsid", help="Obsid of the list's number 0, or of its first row [default: 10100000001].")
@click.option(
    "--tolerance", type=float, help="Largest difference from the list's Sun, Moon and directions, deg [default: 1]."
)
def import_pointings(file: str, output: str, **options: Any) -> None:
    """Convert a list of pointings to a survey table.

    FILE is CSV, ECSV, FITS, or columns separated by blanks. Columns without names are col1, col2, ...; in any list,
    colN is the N-th column. A column whose name is a KEY needs no --map.

    \b
    KEY is a quantity and its unit. The unit may be omitted if it is the first in its line:
      ra dec, or ecl_lon ecl_lat, or gal_lon gal_lat      _deg _hour _rad _arcmin _arcsec _hms _dms
      pa (of the focal plane's +y), sun_angle, moon_angle the same
      time (start of the exposure)                        _iso _jd _mjd _unix; then _utc _tai _tt _tdb
      exptime                                             _s _ms _min _hour _day
      sat_x sat_y sat_z (geocentric GCRS)                 _km _m _au
      sat_vx sat_vy sat_vz                                _km_s _m_s
      sun_x sun_y sun_z, moon_x moon_y moon_z             _km _m _au
      obsid, number (added to --first-obsid), type, deep (yes or no), deep_index (-1: wide survey)

    The unit may also come from a FITS or ECSV file, or from the end of a column's name (start_mjd). Two units that
    differ are an error.

    \b
    A CSV list with RA in hours, DEC, MJD and exptime:
      csstsim import-pointings plan.csv --map ra_hour=RA --map dec=DEC --map time_mjd=MJD --set pa=0 --output table.csv
    A simulation of the Rubin scheduler, and the CSST survey strategy:
      csstsim import-pointings visits.csv --like opsim --output table.csv
      csstsim import-pointings strategy.dat --like csst --output table.csv
    Another list of the same form, with the mapping file of the first import:
      csstsim import-pointings next.csv --mapping table.mapping.yaml --output next_table.csv

    Sun, Moon and a second direction in the list are compared with computed ones. TABLE.rejected.csv has the rejected
    rows, each with the reason. Exit codes: 0 all rows imported, 1 some rejected, 2 nothing imported.
    """
    from csstsim.campaign.pointing_lists.import_pointings import import_pointings as run

    if run(file, output, click.echo, **options):
        sys.exit(1)


@click.command()
@click.argument("campaign", required=False, type=click.Path())
@click.option("--warm", is_flag=True, help="compile all code first (two or three minutes), with a progress bar")
def doctor(campaign: str | None, warm: bool) -> None:
    """Check the installation, and optionally a campaign.

    One line is printed for each check: ok, warning or problem, and what to do. Versions, numba's cache, data files,
    disk, memory and threads are checked. A campaign must open without errors, and fit the disk and memory of this
    machine.

    \b
    For example:
      csstsim doctor
      csstsim doctor campaign.yaml
    Compile once, before many jobs start, or for all users of this installation:
      csstsim doctor --warm

    Exit code 1 if there is a problem. With -q only warnings and problems are printed.
    """
    from csstsim.command_line.doctor import examine
    from csstsim.command_line.doctor.finding import OK, PROBLEM

    if warm:
        from csstsim.stages.warm import warm as compile_all

        compile_all()
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
    """Print the shell code that completes csstsim's commands.

    Completed are commands, options, files, layers, and the exposures and chips of a campaign. The first lines of the
    output are instructions for installation.

    \b
    In this shell only:
      eval "$(csstsim completion bash)"
    To see how to install it:
      csstsim completion zsh | head
    """
    from csstsim.command_line.completion import script

    click.echo(script(shell, click.get_current_context().find_root().command))


TOOLS = init, aim, import_pointings, doctor, completion
