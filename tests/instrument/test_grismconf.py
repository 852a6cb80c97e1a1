"""Files in grismconf's form against the gratings they were written from: by their text alone, and by grismconf."""

import numpy as np
import pytest
from astropy.io import fits
from support.commands import done, refused

from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.filter import GRID
from csstsim.instrument.grismconf import order_name, write_grismconf

PX = 1e-3  # px: the factor of the trace's slope, fitted


def tables(path, order):
    """{DISPX, DISPY, DISPL: (2, 6)} of an order, by the words of the file."""
    found = {}
    for words in map(str.split, path.read_text().splitlines()):
        if words and words[0].startswith("DISP"):
            kind, name, power = words[0].split("_")
            if name == order:
                found.setdefault(kind, {})[int(power)] = np.array(words[1:], float)
    return {kind: np.stack([rows[0], rows[1]]) for kind, rows in found.items()}


@pytest.mark.parametrize("chip", [1, 2, 3, 29])
def test_light_lands_where_the_gratings_send_it(camera, tmp_path, chip):
    for grating, piece in camera.gratings[chip].pieces:
        (path, *_), worst = write_grismconf(tmp_path, grating, piece, camera.chips[chip], camera.telescope)
        assert worst < PX
        x, y = (v.ravel() for v in np.meshgrid(np.linspace(*piece[:2], 5), np.linspace(*piece[2:], 5)))
        field = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        for number, order in grating.orders.items():
            found = {kind: table @ field.T for kind, table in tables(path, order_name(number)).items()}
            p, q, r, s = order.lines(x, y).T
            for wave in np.linspace(*order.range, 5):
                t = (wave - found["DISPL"][0]) / found["DISPL"][1]
                dx, dy = (found[kind][0] + t * found[kind][1] for kind in ("DISPX", "DISPY"))
                assert np.abs(dx - p - q * wave).max() < PX and np.abs(dy - r - s * wave).max() < PX
                if number == 1:
                    assert (t > -0.1).all() and (t < 1.1).all()


def test_the_head_of_a_file_says_which_images_it_is_for(camera, tmp_path):
    """Of rows before columns; ranges of direct images as their distances from the image's corners, order by order."""
    chip, two = camera.chips[1], camera.gratings[1]
    nx, ny = chip.detector.nx, chip.detector.ny
    for grating, bounds in two.pieces:
        x0, x1, y0, y1 = bounds
        paths, _ = write_grismconf(tmp_path / "new", grating, bounds, chip, camera.telescope)
        lines = paths[0].read_text().splitlines()
        assert lines[:2] == [f"# Grating {grating.name}, of chip 1", f"NAXIS {ny} {nx}"]
        beams = [line for line in lines if line.startswith("BEAM")]
        assert beams == ["BEAM_-2", "BEAM_-1", "BEAM_0", "BEAM_+1", "BEAM_+2"]
        words = dict(line.split(maxsplit=1) for line in lines if line and not line.startswith(("#", "BEAM")))
        for name, file in (("-2", "m2"), ("0", "p0"), ("+1", "p1")):
            assert [float(v) for v in words[f"XRANGE_{name}"].split()] == [x0, x1 - nx]
            assert [float(v) for v in words[f"YRANGE_{name}"].split()] == [y0, y1 - ny]
            assert words[f"SENSITIVITY_{name}"] == f"{grating.name}_{file}.fits"
        assert [path.name for path in paths[1:]] == [f"{grating.name}_{k}.fits" for k in ("m2", "m1", "p0", "p1", "p2")]
        assert all(path.exists() for path in paths)


def test_the_sensitivity_counts_the_same_electrons(camera, tmp_path):
    """1 erg / s / cm2 / A: photons through the order's throughput, by hand; nothing beyond the ends."""
    grating, piece = camera.gratings[2].pieces[0]
    paths, _ = write_grismconf(tmp_path, grating, piece, camera.chips[2], camera.telescope)
    with fits.open(next(path for path in paths if path.name.endswith("_p1.fits"))) as file:
        wave, values = (np.asarray(file[1].data[name]) for name in ("WAVELENGTH", "SENSITIVITY"))
    photons = 1e-3 * wave / (H_J_S * C_A_S) * camera.telescope.area_m2
    throughput = np.interp(wave, GRID, grating.orders[1].throughput)
    assert values == pytest.approx(photons * throughput, rel=1e-6) and values[0] == values[-1] == 0.0


def test_the_command_writes_both_gratings(tmp_path):
    said = done("export-grating", 2, "--output", tmp_path / "gv")
    assert len(said.splitlines()) == 2 == len(list((tmp_path / "gv").glob("*.conf")))
    assert len(list((tmp_path / "gv").glob("*.fits"))) == 10
    assert "no gratings in front of this chip" in refused("export-grating", 9, "--output", tmp_path / "r")
    assert not (tmp_path / "r").exists()
