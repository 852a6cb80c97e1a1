"""CTE_effect on a chip: both halves move to their amplifiers, the trail in the overscan, windows, parameters."""

from dataclasses import replace

import numpy as np
import pytest
from support.mini import mini_camera
from support.readout_state import flat_state

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.detector.channels import ReadoutFrame
from csstsim.instrument.camera import load_camera
from csstsim.layers import cte_effect, prescan_overscan

RNG = Streams(3, "1", 9, "cte_effect")
MANY = cte_effect.Param(density_scale=20)  # the small chip has 32 rows to a half
BOTH = cte_effect.Param(density_scale=20, serial=True)


def with_spots(camera, **options):
    """A sky of 5 e- with one row of spots at the same distance from the middle in either half."""
    state = flat_state(camera, 5.0, **options)
    rows = np.arange(state.window.y0, state.window.y1)
    state.image[np.isin(rows, (22, 41))] = 20000
    return state


def test_charge_is_conserved_and_trails_away_from_the_amplifiers(small):
    state = with_spots(small)
    before = state.image.copy()
    state = cte_effect.apply(state, MANY, RNG)
    trailed = sum(trail.sum() for trail in state.trailed.parallel)
    assert [trail.shape for trail in state.trailed.parallel] == [(4, 256)] * 2
    assert before.sum() == state.image.sum() + trailed + state.header["cti_trapped"]
    assert state.header["cti_density"] == 20
    change = (state.image - before).mean(1)
    assert change[22] < -50 and change[41] < -50
    assert change[23] > 2 and change[40] > 2  # read after the spots
    assert change[21] < 0 and change[42] < 0  # read before them: sky only


def test_the_trail_lies_in_the_overscan_first_row_read_first(small):
    state = cte_effect.apply(with_spots(small), MANY, RNG)
    lower, upper = state.trailed.parallel
    state = prescan_overscan.apply(state, prescan_overscan.Param(), RNG)
    frame = ReadoutFrame.of(small.detector, None)
    assert state.trailed is None
    for block in frame.blocks:
        found, cols = state.image[block.parallel_overscan], block.image[1]
        assert np.array_equal(found, upper[::-1, cols] if block.half else lower[:, cols])
        near = found[-1] if block.half else found[0]  # mosaic row next to the half's last active row
        assert near.sum() > 0
    for block in frame.blocks:
        state.image[block.parallel_overscan] = 0
        state.image[block.active] = 0
    assert not state.image.any()


@pytest.mark.parametrize("window", [(40, 200, 10, 64), (0, 256, 33, 50), (5, 6, 0, 20)])
def test_a_window_has_the_traps_of_the_chip(small, window):
    """Where the rest of the chip holds the median charge of the window's half, both are the same bits."""
    x0, x1, y0, y1 = window
    whole = with_spots(small)
    whole.image[:y0], whole.image[y1:] = 5, 5
    part = cte_effect.apply(with_spots(small, window=window), MANY, RNG)
    whole = cte_effect.apply(whole, MANY, RNG)
    assert np.array_equal(part.image, whole.image[y0:y1, x0:x1])
    for half, (rows, trail) in enumerate(zip(((0, 32), (32, 64)), part.trailed.parallel, strict=True)):
        if y0 < rows[1] and y1 > rows[0]:
            assert np.array_equal(trail, whole.trailed.parallel[half][:, x0:x1])
        else:
            assert trail.shape == (4, x1 - x0) and not trail.any()


def test_traps_last_and_releases_do_not(small):
    """One transfer of full pixels catches the same electrons in each exposure; chips and seeds have their own traps."""

    def caught(rng):
        state = cte_effect.apply(flat_state(small, 1e5), MANY, rng)
        return state.image

    first = caught(RNG)
    assert np.array_equal(first, caught(Streams(3, "2", 9, "cte_effect")))
    for other in (Streams(3, "1", 8, "cte_effect"), Streams(4, "1", 9, "cte_effect")):
        assert not np.array_equal(first, caught(other))
    spots = [
        cte_effect.apply(with_spots(small), MANY, rng).image for rng in (RNG, RNG, Streams(3, "2", 9, "cte_effect"))
    ]
    assert np.array_equal(spots[0], spots[1])
    assert not np.array_equal(spots[0], spots[2])


@pytest.mark.parametrize("serial", [False, True])
def test_no_traps_no_change(small, serial):
    state = with_spots(small)
    before = state.image.copy()
    state = cte_effect.apply(state, cte_effect.Param(density_scale=0, serial=serial), RNG)
    assert np.array_equal(state.image, before)
    assert state.header["cti_trapped"] == 0
    assert not any(trail.any() for trail in state.trailed.serial.values()) and bool(state.trailed.serial) == serial
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        cte_effect.Param(density_scale=-1)


def rows_only(camera):
    """The camera with traps in its registers alone, many of them."""
    traps = camera.detector.traps
    many = replace(traps.serial, density=(0.5, 0.5, 0.3))
    detector = replace(camera.detector, traps=replace(traps, density=(0.0,), timescale=(1.0,), serial=many))
    return replace(camera, chips={n: replace(chip, detector=detector) for n, chip in camera.chips.items()})


def behind_and_before(rows, slot):
    """What a channel reads after and before its middle column: the left four are read to the left, the others right."""
    left, right = rows[:, 32 * slot : 32 * slot + 16], rows[:, 32 * slot + 17 : 32 * slot + 32]
    return (right, left) if slot < 4 else (left, right)


def test_each_channel_is_read_towards_its_own_amplifier(small):
    """One bright column in the middle of each channel trails away from the amplifier, one register for all rows."""
    state = flat_state(rows_only(small))
    state.image[:, 16::32] = 20000
    state = cte_effect.apply(state, cte_effect.Param(serial=True), RNG)
    lost = set()
    for rows in (state.image[:32], state.image[32:]):
        for slot in range(8):
            behind, before = behind_and_before(rows, slot)
            assert behind.sum() > 0 and not before.any()
            assert np.ptp(rows[:, 32 * slot + 16]) == 0
            lost.add(20000 - rows[0, 32 * slot + 16])
    assert len(lost) > 4  # each register its own
    assert state.header["cti_trapped"] == 0 < state.header["cti_serial_trapped"]


def test_the_parallel_overscan_is_read_like_the_rows_before_it(small):
    state = flat_state(small)
    state.image[:, 16::32] = 20000
    state = cte_effect.apply(state, cte_effect.Param(density_scale=200, serial=True), RNG)
    for rows in state.trailed.parallel:
        for slot in range(8):
            behind, before = behind_and_before(rows, slot)
            assert behind.sum() > 0 and not before.any()


def test_serial_trails_lie_in_the_overscan(small):
    """All charge, of the parallel overscan's rows, too, is in the frame or in traps; none is in a prescan."""
    state = flat_state(small, 300.0)
    before = state.image.sum(dtype=float)
    alone = cte_effect.apply(flat_state(small, 300.0), MANY, RNG)
    state = cte_effect.apply(state, BOTH, RNG)
    assert state.header["cti_trapped"] == alone.header["cti_trapped"]
    behind = [part.sum() for part in state.trailed.parallel], [part.sum() for part in alone.trailed.parallel]
    assert all(one < other for one, other in zip(*behind, strict=True))
    state = prescan_overscan.apply(state, prescan_overscan.Param(), RNG)
    trapped = state.header["cti_trapped"] + state.header["cti_serial_trapped"]
    assert state.image.sum(dtype=float) + trapped == before
    scan, corners = 0, 0
    for block in ReadoutFrame.of(small.detector, None).blocks:
        assert not state.image[block.prescan].any()
        scan = scan + state.image[block.serial_overscan][block.as_read].sum(0)
        corners += state.image[block.parallel_overscan[0], block.serial_overscan[1]].sum()
    assert scan[0] > 2 * scan[-1] > 0  # what is read first is nearest to the source
    assert corners > 0


@pytest.mark.parametrize("window", [(40, 200, 10, 64), (5, 6, 0, 20), (64, 128, 33, 50)])
def test_a_window_has_the_registers_of_the_chip(small, window):
    """Where the rest of the channel holds the median charge of the window's part, both are the same bits."""
    camera, (x0, x1, y0, y1) = rows_only(small), window
    whole, part = flat_state(camera, 5.0), flat_state(camera, 5.0, window=window)
    bright = np.random.default_rng(2).random(part.image.shape) < 0.05
    part.image[bright] = 5000
    whole.image[y0:y1, x0:x1] = part.image
    param = cte_effect.Param(serial=True)
    frames = []
    for state, place in ((part, window), (whole, None)):
        state = prescan_overscan.apply(cte_effect.apply(state, param, RNG), prescan_overscan.Param(), RNG)
        frames.append(ReadoutFrame.of(camera.chips[9].detector, place).to_stored(state.image, "mosaic"))
    frame = ReadoutFrame.of(camera.chips[9].detector, window)
    kept = np.ix_(frame.rows, frame.cols)
    assert np.array_equal(frames[0][kept], frames[1][kept])
    assert (frames[0][kept] != 5).any(1).all()


def test_registers_last_and_their_releases_do_not(small):
    def frame(*key):
        state = flat_state(rows_only(small), 1e5)
        state.image[:, ::2] = 0
        return cte_effect.apply(state, cte_effect.Param(serial=True), Streams(*key, "cte_effect")).image

    first = frame(3, "1", 9)
    assert np.array_equal(first, frame(3, "1", 9))
    assert not np.array_equal(first, frame(3, "2", 9))
    nearest = slice(None), slice(1, 2)  # what passes empty traps loses to the same ones in each exposure
    assert np.array_equal(first[:32][nearest], frame(3, "2", 9)[:32][nearest])
    assert not np.array_equal(first[:32][nearest], frame(3, "1", 8)[:32][nearest])


def test_rows_without_registers_traps_are_refused(tmp_path):
    folder = mini_camera(tmp_path)
    path = folder / "cti.yaml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.index("serial:")], encoding="utf-8")
    camera = load_camera(folder)
    cte_effect.check(cte_effect.Param(), camera, None)
    with pytest.raises(InputError, match="no `serial` traps"):
        cte_effect.check(BOTH, camera, None)
    path.write_text(text[: text.index("serial:")] + "serial: some", encoding="utf-8")
    with pytest.raises(InputError, match="serial: must be a mapping"):
        load_camera(folder)


def test_what_cannot_be_transferred_is_refused(small):
    state = flat_state(small)
    state.counted = np.ones(state.image.shape, np.int32)
    with pytest.raises(ValueError, match="poisson_and_dark must come before"):
        cte_effect.apply(state, cte_effect.Param(), RNG)


def test_a_camera_without_traps(small):
    bare = replace(small, detector=replace(small.detector, traps=None))
    cte_effect.check(cte_effect.Param(), small, None)
    with pytest.raises(InputError, match=r"no cti\.yaml"):
        cte_effect.check(cte_effect.Param(), bare, None)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("[0.025, 0.105, 0.655]", "[0.025, 0.105]", "species"),
        ("[1.22, 14.02, 84.74]", "[1.22, 0, 84.74]", r"species\.timescale"),
        ("0.492", "-0.5", "beta"),
        ("[0.8, 4.0, 20.0]", "[0.8, -4.0, 20.0]", r"serial\.species\.timescale"),
        ('{value: 85200.0, unit: e-, source: "as', '{value: 0.0, unit: e-, source: "as', r"serial\.well"),
    ],
)
def test_wrong_traps_are_named(tmp_path, old, new, key):
    folder = mini_camera(tmp_path)
    path = folder / "cti.yaml"
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=key):
        load_camera(folder)
    path.unlink()
    assert load_camera(folder).detector.traps is None
