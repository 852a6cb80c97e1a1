"""`csstsim release`: a release described, a public benchmark packed, a catalogue scored against its truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from csstsim.command_line.group import Commands
from csstsim.command_line.options import Finite, of_campaign

if TYPE_CHECKING:
    from csstsim.campaign.opened import OpenCampaign

by = click.option("--author", "authors", multiple=True, metavar="NAME", help="Name of an author; repeat.")
under = click.option(
    "--licence",
    default="CC-BY-4.0",
    show_default=True,
    metavar="LICENCE",
    help="Of the data: CC-BY-4.0, or an address.",
)


@click.group(cls=Commands)
def release() -> None:
    """Describe a release, pack a public benchmark, score catalogues.

    \b
    What a finished campaign is, for programs and repositories:
      csstsim release crate campaign.yaml
    A small public benchmark with its truth apart, and a catalogue that somebody made from it:
      csstsim release pack campaign.yaml --output pack
      csstsim release score found.cat --truth pack/truth --map ra=ALPHA_J2000 --map dec=DELTA_J2000 --output score
    """


@release.command()
@of_campaign
@by
@under
def crate(run: OpenCampaign, authors: tuple[str, ...], licence: str) -> None:
    """Write the RO-Crate metadata of a finished campaign.

    ro-crate-metadata.json says what each file is and how all were made: workflow, campaign, recipes, the run's times.
    It needs the manifest. What it names is copied into workflow/ of the output folder.

    \b
    For example:
      csstsim verify campaign.yaml --manifest
      csstsim release crate campaign.yaml --author "A. N. Other"
    """
    from csstsim.studies.release.campaign_crate import campaign_crate

    campaign_crate(run, click.echo, authors, licence)


@release.command()
@click.argument("campaign", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="Folder of the pack: new, or empty.")
@by
@under
def pack(campaign: str, output: str, authors: tuple[str, ...], licence: str) -> None:
    """Pack a public benchmark from a finished campaign.

    OUTPUT/public has frames as read and calibrated, PSFs of their stars, gratings, a README for strangers, checksums
    and metadata. OUTPUT/truth has the true sky, and the campaign with its seed: keep it. Who guesses the seed can draw
    the truth again, so give the campaign one of many digits.

    \b
    For example:
      csstsim release pack campaign.yaml --output pack
      csstsim compare pack another_pack            the same but for dates, of one campaign
    """
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.studies.release.pack import pack as run

    run(OpenCampaign(campaign), output, click.echo, authors, licence)


@release.command()
@click.argument("catalogue", type=click.Path())
@click.option("--truth", required=True, type=click.Path(), help="The folder `truth` of the pack.")
@click.option("--output", required=True, type=click.Path(), help="Folder of score.html and score.json.")
@click.option("--map", "maps", multiple=True, metavar="KEY=COLUMN", help="Which column has a quantity; repeat.")
@click.option("--band", help="Match and bin by magnitudes in this band [default: the one of most sources].")
@click.option(
    "--radius", type=Finite(0.01, 10.0), default=0.3, show_default=True, help="Least reach of a match, arcsec."
)
def score(catalogue: str, truth: str, output: str, maps: tuple[str, ...], band: str | None, radius: float) -> None:
    """Score a catalogue against the truth of a pack.

    Printed, drawn and written: completeness, purity and matches by chance, and bias and scatter of magnitudes, places,
    shapes and redshifts. CATALOGUE is CSV, ECSV, FITS, parquet,
    source-extractor's text (.cat), or a folder of parquet files.

    \b
    Keys (B: a band), with the units that may follow, the first where none does:
      ra, dec, pa   _deg _hour _rad       mag_B      AB
      flux_B        _ujy _njy _mjy _jy    z          redshift
      e1, e2        (a - b) / (a + b), east and 45 deg to north; _chi: (a2 - b2) / (a2 + b2)
      a, b or q     with pa, in place of e1, e2; pa from north through east
    Columns called so need no --map, but for names of one letter. A line says which are used.
    What is not mapped is not evaluated, and a line says so.

    \b
    For example:
      csstsim release score found.cat --truth pack/truth --output score \\
          --map ra=ALPHA_J2000 --map dec=DELTA_J2000 --map mag_r=MAG_AUTO
      csstsim release score mine.parquet --truth pack/truth --output score --map flux_i_njy=f_i --map z=photoz
    """
    from csstsim.studies.release.score.score import score as run

    run(catalogue, truth, output, click.echo, maps, band, radius)
