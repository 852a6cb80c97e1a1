"""What an exposure says of itself."""

import numpy as np
import pytest
from support.readout_state import flat_state

from csstsim.catalog.astrometry.reduction import apparent
from csstsim.simulation.exposure import Losses
from csstsim.simulation.frame import Frame, shown_table


@pytest.mark.parametrize("shutter", [True, False])
def test_the_interval_has_the_shutters_times_if_the_layers_do(camera, shutter):
    """Near the middle of the mosaic the leaves take another time from a column than at its edge."""
    chip = 6 if 6 in camera.chips else 9
    exposure = flat_state(camera, chip=chip, losses=Losses(flat=True, shutter=shutter, prnu=True), exptime=90.0,
                          window=(0, 9, 0, 4)).exposure  # fmt: skip
    assert exposure.interval.exptime == exposure.exptime == 90.0
    assert (exposure.interval.middle - exposure.pointing.mjd) * 86400 == pytest.approx(45.0, abs=1e-5)
    first, last = exposure.interval.exposed(np.array([0.0, 9000.0]))
    assert np.allclose(first + last, 90.0) and (np.ptp(first) > 0.01) == shutter and (first.min() > 0) == shutter


def test_filter_and_gratings_are_the_chips(camera):
    spectra, image = (flat_state(camera, chip=chip, window=(0, 4, 0, 4)).exposure for chip in (29, 8))
    assert spectra.gratings is camera.gratings[29] and image.gratings is None
    lamp = flat_state(camera, chip=29, window=(0, 4, 0, 4), type="FLAT").exposure
    assert lamp.gratings is None  # its light does not go through them
    assert [one.filter for one in (spectra, image)] == [camera.filters[camera.chips[n].filter] for n in (29, 8)]
    assert image.telescope is camera.telescope
    assert (image.losses, image.mask, image.fidelity) == (Losses(False, False, False), False, "standard")


def test_a_footprint_is_the_windows_corners_grown_by_a_margin(camera, observe):
    from dataclasses import replace

    exposure = flat_state(camera, window=(100, 400, 3000, 3100)).exposure
    with pytest.raises(ValueError, match="made without a campaign"):
        _ = exposure.observer
    exposure = replace(exposure, spacecraft=observe(exposure.pointing))
    places = exposure.footprint(margin_px=20.0)
    x, y = exposure.wcs.world_to_pixel(*apparent(*places, exposure.observer))
    corners = {(round(float(a), 2), round(float(b), 2)) for a, b in zip(x, y, strict=True)}
    assert corners == {(a, b) for a in (79.5, 419.5) for b in (2979.5, 3119.5)}


def frame(**parts):
    """A frame of two channels, side by side, and their bias and gain in the header."""
    from types import SimpleNamespace

    blocks = [SimpleNamespace(channel=3, image=np.s_[:, :2]), SimpleNamespace(channel=12, image=np.s_[:, 2:])]
    values = {
        "image": np.array([[510, 520, 1000, 1100], [530, 500, 1010, 1200]], np.uint16), "truth": None, "wcs": None,
        "window": None, "readout": SimpleNamespace(blocks=blocks),
        "header": {"DETBIA03": 500.0, "GAIN03": 1.5, "DETBIA12": 1000.5, "GAIN12": 2.0},
    }  # fmt: skip
    return Frame(**(values | parts))


def test_electrons_are_dn_less_the_bias_times_the_gain_of_each_channel():
    electrons = frame().electrons
    assert electrons.tolist() == [[15.0, 30.0, -1.0, 199.0], [45.0, 0.0, 19.0, 399.0]]
    assert electrons.dtype == np.float32


def test_a_frame_without_bias_or_gain_has_no_electrons():
    for lacking in ("DETBIA12", "GAIN03"):
        header = {name: value for name, value in frame().header.items() if name != lacking}
        with pytest.raises(ValueError, match="lacks the channels' bias and gain"):
            _ = frame(header=header).electrons
    with pytest.raises(ValueError, match="in electrons already"):
        _ = frame(readout=None, header=None).electrons


def test_a_table_is_shown_with_nine_digits():
    from csstsim.catalog.table import ObjectTable

    shown = shown_table(ObjectTable({"ra": np.array([60.123456789]), "id": np.array([7]), "mag": np.array([21.5])}))
    assert shown.colnames == ["ra", "id", "mag"] and shown["ra"].info.format == shown["mag"].info.format == ".9g"
    assert shown["id"].info.format is None and shown["ra"][0] == 60.123456789
    assert "60.1234568" in str(shown)


@pytest.mark.parametrize("slitless", [False, True])
def test_a_frame_of_a_job_has_the_truth_of_its_state_and_the_wcs_of_its_window(monkeypatch, slitless):
    """Places of both tables count from 1; orders only of a chip behind gratings."""
    from types import SimpleNamespace

    from csstsim.catalog.table import ObjectTable
    from csstsim.simulation.frame import frame_of

    asked = []
    monkeypatch.setattr("csstsim.optics.geometry.icrs_header.icrs_header", lambda *given: asked.append(given) or {})
    monkeypatch.setattr("csstsim.io.truth.truth_table", lambda truth, chip: ObjectTable({"id": truth["id"] + chip.id}))
    orders = ObjectTable({"order": np.array([1, 2]), "x": np.array([4.0, 5.0]), "y": np.array([0.5, 1.0])})
    state = SimpleNamespace(truth=ObjectTable({"id": np.array([10, 20])}), orders=orders if slitless else None)
    chip = SimpleNamespace(id=3, filter="i")
    job = SimpleNamespace(chip=chip, window="window", key=("101", 3), wcs="wcs", observer="observer")
    image = np.ones((2, 3))
    made = frame_of(job, state, image, raw=2 * image, header="header")
    assert made.image is image and made.raw[0, 0] == 2 and made.header == "header" and made.readout is None
    assert made.truth["id"].tolist() == [13, 23] and (made.window, made.key, made.filter) == ("window", ("101", 3), "i")
    assert asked == [("wcs", "observer", "window")] and made.wcs.naxis == 2
    if slitless:
        assert made.orders.colnames == ["order", "xImage", "yImage"]
        assert made.orders["xImage"].tolist() == [5.0, 6.0] and made.orders["yImage"].tolist() == [1.5, 2.0]
    else:
        assert made.orders is None
