"""Commands for gratings: fit a grating to ray tracing, export a grating for other programs."""

import click


@click.command("fit-grating")
@click.argument("samples", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="New aXe configuration file, NAME.conf.")
@click.option("--sensitivity", "stem", help="Stem of the sensitivity files, STEM_p1.fits, ... [default: NAME].")
def fit_grating(samples: str, output: str, stem: str | None) -> None:
    """Fit a grating's traces and dispersion to ray tracing.

    Equations 1 to 4 of the paper are fitted to traced rays. The residuals of the fit are printed in px.

    \b
    SAMPLES is a CSV table with one row per ray and this header:
      order,m,n,wavelength,x,y
    order       -2, -1, 0, 1 or 2; the first order is required
    m, n        0-based pixel of the direct image: the position without the grating
    wavelength  angstrom
    x, y        0-based pixel of the dispersed ray

    The paper samples 10 x 10 positions on the grating's part of the chip and 8 wavelengths. At least 3 x 3 positions
    and 2 wavelengths are required. The dispersion is along x.

    \b
    For example, with the rays of a shipped grating:
      python builders/build_gratings.py --samples GI1 > samples.csv
      csstsim fit-grating samples.csv --output results/GI1.conf --sensitivity GI
    """
    from csstsim.optics.gratings.trace_fit import fit_file, fit_report

    click.echo("\n".join(fit_report(fit_file(samples, output, stem))))


@click.command("export-grating")
@click.argument("chip", type=click.IntRange(1))
@click.option("--output", required=True, type=click.Path(), help="Output folder.")
@click.option("--instrument", type=click.Path(), help="Folder of the camera [default: the shipped one].")
def export_grating(chip: int, output: str, instrument: str | None) -> None:
    """Write a chip's gratings as grismconf files.

    A .conf file and the sensitivity of each order are written for both gratings of the chip, in the format of the
    Python package grismconf. csstsim itself reads gratings from aXe files (config/instrument/gratings).

    \b
    For example:
      csstsim export-grating 2 --output gv
    """
    from csstsim.base.errors import InputError
    from csstsim.instrument.camera import load_camera
    from csstsim.instrument.grismconf import write_grismconf

    camera = load_camera(instrument)
    if chip not in camera.gratings:
        allowed = ", ".join(map(str, camera.gratings))
        raise InputError("no gratings in front of this chip", key="CHIP", value=chip, allowed=allowed)
    for grating, piece in camera.gratings[chip].pieces:
        (path, *_), largest_error = write_grismconf(output, grating, piece, camera.chips[chip], camera.telescope)
        click.echo(f"{path}: wavelengths within {largest_error:.1e} px")
