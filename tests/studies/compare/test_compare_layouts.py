"""Level-0 pixels compare as equal in every layout, compressed or not; a changed pixel is found in each."""

from itertools import permutations

import numpy as np
import pytest
from delivery import spoil
from support.readout_state import flat_state, plain_layers, run

from csstsim.detector.mask import HOT
from csstsim.io.level0 import read_level0
from csstsim.io.level0_writing import write_level0
from csstsim.studies.compare.compare import facts

PROVENANCE = {
    "recipe": {"campaign": "c0ffee", "camera": "cafe", "layers": "1ee7", "exposure": "beef"}, "seed": 11,
    "campaign_name": "demo", "layers": [{"gain": {"gain_16channel": True}}],
}  # fmt: skip
WINDOWS = None, (100, 170, 10, 50)
FORMS = "channels", "mosaic", "packed"
PAIRS = [*permutations(FORMS, 2)]


def digitised(small, window=None, change=lambda state: None):
    state = flat_state(small, 300.0, window=window)
    state.mask = np.zeros(state.image.shape, np.uint8)
    state = run(state, plain_layers())
    change(state)
    return state


def written(small, folder, state, forms=FORMS):
    """Write a state in every form; return {form: path}."""
    folder.mkdir()
    for form in forms:
        state.header["compress"] = form == "packed"
        layout = "mosaic" if form == "mosaic" else "channels"
        write_level0(folder / f"{form}.fits", state, small.keywords, PROVENANCE, layout)
    return {form: folder / f"{form}.fits" for form in forms}


def texts(a, b):
    return [fact.text for fact in facts(a, b) if not fact.provenance]


@pytest.mark.parametrize("window", WINDOWS)
def test_the_same_pixels_are_the_same(small, tmp_path, window):
    paths = written(small, tmp_path / "a", digitised(small, window))
    for a, b in PAIRS:
        assert texts(paths[a], paths[b]) == [], (a, b)


@pytest.mark.parametrize("window", WINDOWS)
def test_a_pixel_is_found_in_each(small, tmp_path, window):
    """The same pixel, at the same position, for all layouts; its position in the assembled image."""

    def change(state):
        state.image[13, 9] += 3
        state.mask[2, 7] = HOT

    state, other = digitised(small, window), digitised(small, window, change)
    paths, changed = written(small, tmp_path / "a", state), written(small, tmp_path / "b", other)
    files = [read_level0(found["mosaic"]) for found in (paths, changed)]
    images = [file.assembled(full=True).astype(int) for file in files]
    ((y, x),) = np.argwhere(images[0] != images[1])
    ((my, mx),) = np.argwhere(files[1].mask())
    corner = files[0].window
    wanted = set()
    for a, b in [*PAIRS, *zip(FORMS, FORMS, strict=True)]:
        image, mask = texts(paths[a], changed[b])
        wanted.add(image)
        assert f"(chip x {x}, y {y}): {images[0][y, x]} and {images[1][y, x]}" in image
        assert mask.startswith("MASK: 1 of ")
        assert f"(chip x {mx + corner.x0}, y {my + corner.y0}): 0 and {HOT}" in mask
    assert all("differs, by at most 3 DN, rms 3 DN, first in channel " in text for text in wanted)


def test_keywords_are_compared_across_layouts(small, tmp_path):
    paths = written(small, tmp_path / "a", digitised(small))
    spoil.header("IMAGE", "GAIN03", lambda gain: gain + 0.5)(paths["channels"])
    spoil.header(0, "EXPTIME", lambda seconds: seconds + 1)(paths["channels"])
    for other in ("mosaic", "packed"):
        found = texts(paths["channels"], paths[other])
        assert [text.split(":")[1].strip() for text in found] == ["EXPTIME", "GAIN03"], found
        assert found[1].endswith("differ by 0.5")


def test_another_window_is_reported(small, tmp_path):
    """Keywords that say which pixels were read, channels that were not, pixels that are 0."""
    whole = written(small, tmp_path / "a", digitised(small), ("channels",))
    part = written(small, tmp_path / "b", digitised(small, WINDOWS[1]), ("channels",))
    found = texts(whole["channels"], part["channels"])
    assert any(text.startswith("IMAGE: READX0: 1 and 101") for text in found)
    assert any(text.startswith("only A has the channels 1, 2, 3") for text in found)


def test_another_detector_is_reported(small, tmp_path):
    from support.mini import mini_camera

    from csstsim.instrument.camera import load_camera

    (tmp_path / "other").mkdir()
    other = load_camera(mini_camera(tmp_path / "other", nx=128, ny=128, channel_nx=16, channel_ny=64))
    a = written(small, tmp_path / "a", digitised(small), ("channels",))
    b = written(other, tmp_path / "b", digitised(other), ("channels",))
    assert any(text.startswith("IMAGE: detectors of another geometry") for text in texts(a["channels"], b["channels"]))
