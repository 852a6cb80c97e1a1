"""Charge in an image against its truth's sum: conserved through every layer, windows and clipping included."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_delivery import science
from support.commands import done
from support.mini_campaign import POINTINGS, write_scene

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.delivery.charge_budget import charge_faults, charge_of
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth

PLACES = ([20.0, 60.0, 90.5], [30.0, 64.0, 100.0])


def made(folder, mag=19.0, layers=None, **changes):
    """Draw three stars; return (Level0, truth) of their frame."""
    if layers is not None:
        changes["observations"] = {"SCIE": str(science(folder, **layers))}
    file = write_scene(folder, "Stars", *PLACES, mag, pointing=POINTINGS[0], **changes)
    run = OpenCampaign(file)
    (job,) = run.jobs
    done("chip", file, "--obsid", job.obsid, "--chip", job.chip.id)
    return read_level0(run.paths.level0(job)), read_truth(run.paths.level0_truth(job))


def expected(budget):
    arrived = sum(budget[name] for name in ("light", "dark", "rays", "defects"))
    return arrived - budget["trapped"] - budget["bloomed"]


@pytest.mark.parametrize(
    "changes",
    [
        {"layers": {"CTE_effect": {"density_scale": 100.0, "serial": True}}},
        {"layers": {"CTE_effect": {"density_scale": 1.0}}, "window": {"x0": 30, "x1": 101, "y0": 40, "y1": 90}},
        {"layers": {"quantization_and_output": {"layout": "mosaic", "compress": True, "mask": True}}},
        {"fidelity": "noise_free"},
    ],
)
@pytest.mark.thorough
def test_charge_is_conserved(tmp_path, changes):
    """Within 4 sigma of readout, bias and shot noise (fixed seed), without the tolerance for what is uncounted."""
    file, truth = made(tmp_path, **changes)
    budget, charge = truth.meta["electrons"], charge_of(file, truth.meta["full_well"])
    assert charge.clipped == 0 and budget["light"] > budget["objects"] > 0
    sigma = (charge.error**2 + budget["light"] + budget["dark"]) ** 0.5
    assert abs(charge.electrons - expected(budget)) < 4 * sigma
    assert list(charge_faults(file, truth)) == []


@pytest.mark.thorough
def test_a_readout_without_noise_has_that_of_rounding(tmp_path):
    """Where the overscan is one number, a pixel's charge is still known to 12**-0.5 DN alone."""
    file, truth = made(tmp_path)
    file.__dict__["_stored"] = np.full_like(file._stored, 500)
    variance = 0.0
    for channel in file.channels():
        pixels = channel.active.size + channel.serial_overscan.size + channel.parallel_overscan.size
        variance += file.gain[channel.number] ** 2 / 12 * pixels * (1 + pixels / channel.serial_overscan.size)
    charge = charge_of(file, truth.meta["full_well"])
    assert charge.electrons == 0.0 and charge.error == pytest.approx(variance**0.5, rel=1e-6)


def test_clipped_pixels_hide_charge_up_to_the_full_well(tmp_path):
    file, truth = made(tmp_path, mag=14.0)
    budget, charge = truth.meta["electrons"], charge_of(file, truth.meta["full_well"])
    lost = expected(budget) - charge.electrons
    assert charge.clipped > 20 and 0 < lost <= charge.clipped * (truth.meta["full_well"] - charge.clipped_at)
    assert list(charge_faults(file, truth)) == []


@pytest.mark.parametrize(("name", "change"), [("light", 1.02), ("light", 0.98), ("objects", 1.001)])
def test_a_budget_that_does_not_hold(tmp_path_factory, name, change):
    folder = tmp_path_factory.getbasetemp() / "budget"
    folder.mkdir(exist_ok=True)
    file, truth = made(folder, mag=19.0)
    truth.meta["electrons"][name] *= change
    assert len(list(charge_faults(file, truth))) == 1


def test_a_bright_star_moved_away_is_missed(tmp_path):
    """Pixels of the brightest star replaced by their neighbours' sky, as a stale image would have them."""
    file, truth = made(tmp_path, mag=18.0)
    stored = np.array(file._stored)
    stored[stored > np.median(stored) + 200] = np.median(stored)
    file.__dict__["_stored"] = stored
    (fault,) = charge_faults(file, truth)
    assert "the image holds" in fault


def two_channels(layout="channels", nonlinearity=None):
    """A file of two channels unlike each other in gain, level, sizes and sides, with one clipped pixel each."""
    scan = (np.full((4, 10), 500, np.uint16), np.full((4, 10), 600, np.uint16))
    rest = np.zeros((4, 0), np.uint16)
    channels = [
        SimpleNamespace(
            number=1, active=np.array([[510] * 5, [500] * 4 + [65535]], np.uint16), parallel_overscan=scan[0][:1],
            serial_overscan=scan[0] if layout != "chip" else rest,
        ),
        SimpleNamespace(
            number=7, active=np.array([[630, 600, 65535]], np.uint16), parallel_overscan=scan[1][:0],
            serial_overscan=scan[1] if layout != "chip" else rest,
        ),
    ]  # fmt: skip
    blocks = [SimpleNamespace(flip_x=False), SimpleNamespace(flip_x=True)]
    return SimpleNamespace(
        header={"SATURATE": 65535}, readout=SimpleNamespace(blocks=blocks), channels=lambda: iter(channels),
        gain={1: 1.5, 7: 2.0}, levels={1: (500.0, 6.0), 7: (600.0, 4.0)}, nonlinearity=nonlinearity or {},
    )  # fmt: skip


def test_the_charge_of_two_channels_by_hand():
    """Each by its own gain and level; what is clipped, and where the lower of the two converters ends."""
    charge = charge_of(two_channels(), 200_000.0)
    ends = (65535 - 500) * 1.5, (65535 - 600) * 2.0
    assert charge.electrons == pytest.approx(5 * 10 * 1.5 + ends[0] + 30 * 2.0 + ends[1], rel=1e-12)
    assert (charge.clipped, charge.clipped_at) == (2, pytest.approx(min(ends)))
    # 10 + 40 + 10 pixels by a level of 40, and 3 + 40 by one of 40; noise is that of rounding
    variance = (1.5**2 * 60 * (1 + 60 / 40) + 2.0**2 * 43 * (1 + 43 / 40)) / 12
    assert charge.error == pytest.approx(variance**0.5, rel=1e-12)


def test_charge_that_trails_into_the_overscan_is_charge_and_no_level():
    """Three DN in the columns next to the active pixels: the first of one channel, the last of the mirrored one."""
    plain, trailed = charge_of(two_channels(), 200_000.0).electrons, two_channels()
    for channel, columns in zip(trailed.channels(), (slice(0, 1), slice(-1, None)), strict=True):
        channel.serial_overscan = channel.serial_overscan.copy()
        channel.serial_overscan[:, columns] += 3
    assert charge_of(trailed, 200_000.0).electrons - plain == pytest.approx(4 * 3 * 1.5 + 4 * 3 * 2.0, rel=1e-9)


def test_without_overscan_the_levels_are_those_that_the_file_states():
    charge = charge_of(two_channels("chip"), 200_000.0)
    ends = (65535 - 500) * 1.5, (65535 - 600) * 2.0
    assert charge.electrons == pytest.approx(75 + ends[0] + 60 + ends[1], rel=1e-12)
    assert charge.error == pytest.approx((6.0**2 * 20 + 4.0**2 * 3) ** 0.5, rel=1e-12)


def test_each_channels_nonlinearity_is_undone():
    """signal = x + a x2 + b x3, of the second channel alone: x of 60 electrons by numpy's roots."""
    quadratic, cubic = -1e-3, 1e-6
    file = two_channels(nonlinearity={7: (quadratic, cubic)})
    (root,) = (r.real for r in np.roots([cubic, quadratic, 1.0, -60.0]) if abs(r.imag) < 1e-9 and 0 < r.real < 100)
    channel = list(file.channels())[1]
    channel.active[0, 2] = 600
    found = charge_of(file, 300.0).electrons - (75 + (65535 - 500) * 1.5)
    assert found == pytest.approx(root, rel=1e-8) and abs(root - 60) > 3


def budget_of(**changes):
    """The budget that the file of two channels has exactly, with changes to it."""
    total = 75 + 60 + (65535 - 500) * 1.5 + (65535 - 600) * 2.0
    budget = {"objects": 10.0, "light": total + 600, "dark": 30.0, "rays": 20.0, "defects": 50.0, "trapped": 700.0}
    for name, more in changes.items():
        budget[name] = budget.get(name, 0.0) + more
    return budget


@pytest.mark.parametrize(("changes", "full_well", "good"), [
    ({}, 0.0, True), ({"bloomed": 0.0}, 0.0, True),
    # 6 sigma of 227,000 electrons, and a thousandth of them: 3100
    ({"light": 2900.0, "bloomed": 0.0}, 0.0, True), ({"light": 3400.0, "bloomed": 0.0}, 0.0, False),
    ({"light": -2900.0, "bloomed": 0.0}, 0.0, True), ({"light": -3400.0, "bloomed": 0.0}, 0.0, False),
    ({"bloomed": 3400.0}, 0.0, False), ({"bloomed": 3400.0, "dark": 3400.0}, 0.0, True),
    ({"rays": 3400.0, "trapped": 3400.0, "bloomed": 0.0}, 0.0, True), ({"defects": 3400.0, "bloomed": 0.0}, 0.0, False),
    ({"light": 3400.0, "bias_structure": 400.0, "bloomed": 0.0}, 0.0, True),
    # two clipped pixels hide up to the full well each, or any charge where nothing limits a pixel
    ({"light": 200_000.0, "bloomed": 0.0}, 200_000.0, True), ({"light": 211_000.0, "bloomed": 0.0}, 200_000.0, False),
    ({"light": 1e7}, 0.0, True), ({"light": -3400.0}, 0.0, False),
    # dark current has shot noise as light has
    ({"light": -200_000.0, "dark": 202_900.0, "bloomed": 0.0}, 0.0, True),
    ({"light": -200_000.0, "dark": 203_400.0, "bloomed": 0.0}, 0.0, False),
])  # fmt: skip
def test_how_far_image_and_budget_may_be_apart(changes, full_well, good):
    budget = budget_of(**changes)
    table = ObjectTable({"drawn": np.array([4.0, 6.0])}, {"electrons": budget, "full_well": full_well or 97_000.0})
    found = list(charge_faults(two_channels(), table))
    assert len(found) == (not good), found


@pytest.mark.parametrize(
    ("drawn", "good"), [([4.0, 6.9], True), ([4.0, 7.1], False), ([4.0, 5.1], True), ([8.9], False)]
)
def test_the_objects_sum_to_what_the_image_was_given(drawn, good):
    budget = budget_of()
    table = ObjectTable({"drawn": np.array(drawn)}, {"electrons": budget, "full_well": 1e5})
    assert (list(charge_faults(two_channels(), table)) == []) is good
    budget["objects"] = 1e9  # of many electrons the last digits are rounded
    for off, sound in ((5e3, True), (2e4, False)):
        many = ObjectTable({"drawn": np.array([1e9 + off])}, {"electrons": budget, "full_well": 1e5})
        assert (list(charge_faults(two_channels(), many)) == []) is sound
    budget["objects"] = 0.0
    none = ObjectTable({"id": np.zeros(0)}, {"electrons": budget, "full_well": 1e5})
    assert list(charge_faults(two_channels(), none)) == []
