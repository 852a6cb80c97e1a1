"""Commands about gratings: fitted to ray tracing, and written for other programs."""

import click


@click.command("fit-grating")
@click.argument("samples", type=click.Path())
@click.option("--output", required=True, type=click.Path(), help="The aXe configuration to write, NAME.conf.")
@click.option("--sensitivity", "stem", help="Stem of its sensitivity files, STEM_p1.fits, ... [default: NAME].")
def fit_grating(samples: str, output: str, stem: str | None) -> None:
    """Fit a grating's traces and dispersion to ray tracing.

    Equations 1 to 4 of the paper are fitted to trajectories.

    \b
    SAMPLES is a CSV table, one row a ray, with a heading:
      order,m,n,wavelength,x,y
    order       -2, -1, 0, 1 or 2; the first is needed
    m, n        0-based pixel of the direct image, which is where light would land without the grating
    wavelength  angstrom
    x, y        0-based pixel on which that light lands

    The paper samples 10 x 10 positions over the grating's piece of the chip and 8 wavelengths. At least 3 x 3 positions
    and 2 wavelengths are needed. Dispersion runs along x. The residuals of the fit are printed, in px.

    \b
    To try it, with the trajectories behind a shipped grating:
      python builders/build_gratings.py --samples GI1 > samples.csv
      csstsim fit-grating samples.csv --output results/GI1.conf --sensitivity GI
    """
    from csstsim.optics.gratings.trace_fit import fit_file, fit_report

    click.echo("\n".join(fit_report(fit_file(samples, output, stem))))


@click.command("export-grating")
@click.argument("chip", type=click.IntRange(1))
@click.option("--output", required=True, type=click.Path(), help="Folder for the files.")
@click.option("--instrument", type=click.Path(), help="Folder of the camera [default: the shipped one].")
def export_grating(chip: int, output: str, instrument: str | None) -> None:
    """Write a chip's gratings in grismconf's form.

    A .conf and the sensitivity of each order are written for both gratings. grismconf and what is built on it read
    them. The files from which csstsim reads a grating, in aXe's form, are in instrument/gratings.

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
        (path, *_), worst = write_grismconf(output, grating, piece, camera.chips[chip], camera.telescope)
        click.echo(f"{path}: wavelengths within {worst:.1e} px")
