"""`csstsim release`: metadata of a release, public benchmark packs, scores of catalogues against the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from csstsim.command_line.group import Commands
from csstsim.command_line.options import Finite, of_campaign

if TYPE_CHECKING:
    from csstsim.campaign.opened import OpenCampaign

authors_opt = click.option(
    "--author", "authors", multiple=True, metavar="NAME", help="Name of an author; may be repeated."
)
licence_opt = click.option(
    "--licence",
    default="CC-BY-4.0",
    show_default=True,
    metavar="LICENCE",
    help="Licence of the data: CC-BY-4.0, or the URL of another.",
)


@click.group(cls=Commands)
def release() -> None:
    """Describe a release, pack a public benchmark, score catalogues.

    \b
    Metadata of a finished campaign, for repositories and programs:
      csstsim release crate campaign.yaml
    A public benchmark with its truth in a separate folder, and the score of a catalogue made from it:
      csstsim release pack campaign.yaml --output pack
      csstsim release score found.cat --truth pack/truth --map ra=ALPHA_J2000 --map dec=DELTA_J2000 --output score
    """


@release.command()
@of_campaign
@authors_opt
@licence_opt
def crate(run: OpenCampaign, authors: tuple[str, ...], licence: str) -> None:
    """Write the RO-Crate metadata of a finished campaign.

    ro-crate-metadata.json describes each file and its provenance: workflow, campaign, recipes, run times. The manifest
    is needed. The files of the workflow that it names are copied into workflow/ of the output folder.

    \b
    For example:
      csstsim verify campaign.yaml --manifest
      csstsim release crate campaign.yaml --author "A. N. Other"
    """
    from csstsim.studies.release.campaign_crate import campaign_crate

    campaign_crate(run, click.echo, authors, licence)


@release.command()
@click.argument("campaign", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="Folder of the pack, new or empty.")
@authors_opt
@licence_opt
def pack(campaign: str, output: str, authors: tuple[str, ...], licence: str) -> None:
    """Pack a public benchmark from a finished campaign.

    OUTPUT/public has raw and calibrated frames, PSFs measured from their stars, gratings, a README, checksums and
    metadata. OUTPUT/truth has the true sky and the campaign with its seed: do not publish it. The truth can be
    simulated again from the seed, so give the campaign a seed of many digits.

    \b
    For example:
      csstsim release pack campaign.yaml --output pack
      csstsim compare pack another_pack            packs of one campaign differ only in dates
    """
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.studies.release.pack import pack as run

    run(OpenCampaign(campaign), output, click.echo, authors, licence)


@release.command()
@click.argument("catalogue", type=click.Path())
@click.option("--truth", required=True, type=click.Path(), help="Folder `truth` of the pack.")
@click.option("--output", required=True, type=click.Path(), help="Folder of score.html and score.json.")
@click.option("--map", "maps", multiple=True, metavar="KEY=COLUMN", help="Column with a quantity; may be repeated.")
@click.option("--band", help="Band for matching and binning by magnitude [default: the band with most sources].")
@click.option(
    "--radius", type=Finite(0.01, 10.0), default=0.3, show_default=True, help="Minimum matching radius, arcsec."
)
def score(catalogue: str, truth: str, output: str, maps: tuple[str, ...], band: str | None, radius: float) -> None:
    """Score a catalogue against the truth of a pack.

    Completeness, purity, the rate of chance matches, and bias and scatter of magnitudes, positions, shapes and
    redshifts are printed, plotted and written. CATALOGUE is CSV, ECSV, FITS, parquet, text of SExtractor (.cat), or a
    folder of parquet files.

    \b
    KEY is a quantity (B: a band) and its unit. The first unit is the default:
      ra, dec, pa   _deg _hour _rad       mag_B      AB
      flux_B        _ujy _njy _mjy _jy    z          redshift
      e1, e2        (a - b) / (a + b), e1 along east, e2 at 45 deg towards north; _chi: (a2 - b2) / (a2 + b2)
      a, b or q     with pa, instead of e1, e2; pa from north through east
    A column whose name is a KEY of at least two letters needs no --map. The columns used are printed. A quantity
    without a column is not evaluated, which is printed, too.

    \b
    For example:
      csstsim release score found.cat --truth pack/truth --output score \\
          --map ra=ALPHA_J2000 --map dec=DELTA_J2000 --map mag_r=MAG_AUTO
      csstsim release score mine.parquet --truth pack/truth --output score --map flux_i_njy=f_i --map z=photoz
    """
    from csstsim.studies.release.score.score import score as run

    run(catalogue, truth, output, click.echo, maps, band, radius)
