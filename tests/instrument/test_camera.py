"""The shipped camera against the published layout, and input that load_camera refuses."""

import math

import numpy as np
import pytest
import yaml
from support.mini import INSTRUMENT, mini_camera

from csstsim.base.errors import InputError
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window


def test_chip_counts_and_filters(camera):
    """Paper, figure 3, and design: 30 chips, 18 imaging; NUV and y four each, u g r i z two, each grating four."""
    assert sorted(camera.chips) == list(range(1, 31))
    assert len(camera.imaging_chips) == 18 and len(camera.slitless_chips) == 12
    count = {name: sum(c.filter == name for c in camera.chips.values()) for name in camera.filters}
    assert count == {"NUV": 4, "u": 2, "g": 2, "r": 2, "i": 2, "z": 2, "y": 4, "GU": 4, "GV": 4, "GI": 4}
    assert [c.id for c in camera.imaging_chips if c.filter == "r"] == [9, 22]


def test_layout_follows_gaps(camera):
    """Centres from the published rule: pitch 9216 + 534 and 9232 + 898, outer gratings 1309 px further out."""
    for chip in camera.chips.values():
        row, column = (chip.id - 1) % 5 + 1, 6 - (chip.id - 1) // 5
        side = math.copysign(1, column - 3.5)
        shift = side * (1309 - 534) if chip.kind == "slitless" else 0.0
        assert (chip.row, chip.column) == (row, column)
        assert chip.xc == (4608 + 267) * (2 * (column - 1) - 5) + shift
        assert chip.yc == (9232 + 898) * (row - 3)
        assert chip.rotation == (side if chip.kind == "slitless" else 0.0)


def test_no_two_chips_overlap(camera):
    chips = list(camera.chips.values())
    for i, a in enumerate(chips):
        for b in chips[i + 1 :]:
            assert abs(a.xc - b.xc) >= 9216 + 534 or abs(a.yc - b.yc) >= 9232 + 898


def test_detector_and_telescope(camera):
    """Channel geometry makes the published stored sizes: 1250 x 4700 a channel, 10000 x 9400 the chip."""
    d = camera.detector
    assert (d.nx, d.ny, d.channels) == (9216, 9232, 16)
    assert d.prescan + d.channel_nx + d.overscan == 1250
    assert d.channel_ny + d.parallel_overscan == 4700
    assert d.bias / d.gain == pytest.approx(454.545, abs=1e-3)  # DN
    assert camera.telescope.area_m2 == pytest.approx(math.pi)
    # 10 um at 28 m, against the pixel scale the headers state: 0.5% apart, as published.
    arcsec = math.degrees(d.pixel_um * 1e-6 / camera.telescope.focal_length_m) * 3600
    assert camera.telescope.pixel_scale == pytest.approx(arcsec, rel=5e-3)


def test_window():
    w = Window(10, 20, 0, 5)
    assert (w.nx, w.ny, w.shape) == (10, 5, (5, 10))
    x = np.array([9.49, 9.5, 19.49, 19.5, np.nan])
    assert w.contains(x, 2.0).tolist() == [False, True, True, False, False]
    assert not w.contains(15.0, -0.51) and w.contains(15.0, -0.5) and not w.contains(15.0, 4.5)
    image = np.arange(8 * 25).reshape(8, 25)
    assert image[Window(10, 20, 2, 7).slices].tolist() == image[2:7, 10:20].tolist()
    assert Window(3, 3, 0, 5).shape == (5, 0) and not Window(3, 3, 0, 5).contains(3.0, 1.0)


def test_label_and_full_window(camera):
    assert camera.chips[8].label == "08" and camera.chips[30].label == "30"
    assert camera.chips[8].full_window == Window(0, 9216, 0, 9232)


def test_every_number_has_provenance():
    """An independent walk: above each number stands a mapping with a source and a confidence."""

    def walk(node, covered, where):
        if isinstance(node, dict):
            covered = covered or (bool(node.get("source")) and bool(node.get("confidence")))
            for key, value in node.items():
                walk(value, covered, f"{where}.{key}")
        elif isinstance(node, list):
            for item in node:
                walk(item, covered, where)
        elif isinstance(node, int | float) and not isinstance(node, bool):
            assert covered, f"{where} = {node}"

    for path in INSTRUMENT.glob("*.yaml"):
        walk(yaml.safe_load(path.read_text(encoding="utf-8")), False, path.name)


def test_mini_camera_is_small_and_loads(tmp_path):
    mini = load_camera(mini_camera(tmp_path))
    assert mini.detector.nx == 256 and mini.detector.ny == 64 and len(mini.chips) == 30
    assert mini.chips[8].xc == pytest.approx(14625 / 9216 * 256)


def test_digest_follows_content_not_place(tmp_path, camera):
    first = load_camera(mini_camera(tmp_path / "a"))
    second = load_camera(mini_camera(tmp_path / "b"))
    assert first.digest == second.digest != camera.digest and len(first.digest) == 16
    for name in ("README.md", "prnu_09.png", "notes.txt", "detector.yaml~", ".detector.yaml.swp"):
        (second.folder / name).write_text("words")
    assert load_camera(second.folder).digest == first.digest
    path = second.folder / "detector.yaml"
    path.write_text(path.read_text() + "# one more comment\n")
    assert load_camera(second.folder).digest != first.digest


def _spoil(tmp_path, file, old, new):
    folder = mini_camera(tmp_path)
    text = (folder / file).read_text(encoding="utf-8")
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("detector.yaml", "confidence: S", "confidence: X", ["confidence", "'X'", "S, D, K, E"]),
        ("detector.yaml", "  confidence: S", "", ["confidence is missing", "geometry"]),
        ("detector.yaml", "channel_nx: 32", "channel_nx: 33", ["nx", "256", "264"]),
        ("detector.yaml", "channels_y: 2", "channels_y: 1", ["channels_y", "got 1"]),
        ("detector.yaml", "prescan: 3", "prescan: -3", ["prescan", "-3"]),
        ("detector.yaml", "prescan: 3", "prescan: 3.5", ["prescan", "integer", "3.5"]),
        ("detector.yaml", "prescan: 3", "prescam: 3", ["unknown key", "prescam", "prescan"]),
        ("telescope.yaml", "{value: 1, ", "{value: 2, ", ["telescope.parity", "got 2", "1 or -1"]),
        ("telescope.yaml", "{value: 0.074", "{value: .nan", ["pixel_scale", "nan"]),
        ("telescope.yaml", "2025-01-01T", "2025-13-01T", ["orbit.epoch", "2025-13-01"]),
        ("telescope.yaml", "  altitude_km: {value: 400.0", "  altitude_km: {value: -1.0", ["altitude_km", "-1.0"]),
        ("filters.yaml", "[2492, .03]", "[2449, .03]", ["NUV.nodes", "must rise"]),
        ("filters.yaml", "[2492, .03]", "[2492, 1.03]", ["NUV.nodes", "0..1"]),
        ("filters.yaml", "[2492, .03]", "[2492, -0.03]", ["NUV.nodes", "0..1"]),
        ("filters.yaml", "[10563, .02], [10950, 0]]", "[10563, .02], [11001, 0]]", ["nodes", "within 2000-11000 A"]),
        ("filters.yaml", "[2492, .03]", "[2492]", ["NUV.nodes.1", "too few numbers"]),
        ("filters.yaml", "[2492, .03]", "[2492, .nan]", ["NUV.nodes.1.1", "finite"]),
        ("filters.yaml", "kind: imaging", "kind: imagery", ["NUV.kind", "imagery", "slitless"]),
        ("chips.yaml", "filter: GI", "filter: GX", ["filter", "'GX'", "NUV"]),
        ("chips.yaml", "id: 1\n", "id: 2\n", ["chips[1].id", "another chip has this id"]),
        ("chips.yaml", "id: 1\n", "id: 100\n", ["chips[0].id", "100"]),
        ("chips.yaml", "rotation: 1.0", "turn: 1.0", ["chips[0].rotation", "missing"]),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, file, old, new, words):
    folder = _spoil(tmp_path, file, old, new)
    with pytest.raises(InputError) as caught:
        load_camera(folder)
    message = str(caught.value)
    assert "\n" not in message and file in message
    for word in words:
        assert word in message, message


def test_bare_number_and_missing_file(tmp_path):
    folder = mini_camera(tmp_path)
    with (folder / "telescope.yaml").open("a") as out:
        out.write("\nspare: 3\n")
    with pytest.raises(InputError, match=r"telescope.yaml: spare: a number without source"):
        load_camera(folder)
    (folder / "filters.yaml").unlink()
    with pytest.raises(InputError, match=r"filters.yaml: cannot read the file: No such file"):
        load_camera(folder)
    with pytest.raises(InputError, match="no such instrument folder"):
        load_camera(tmp_path / "nowhere")


@pytest.mark.parametrize(("channels", "size"), [(1, 256), (8, 32), (16, 16)])
def test_half_the_columns_go_to_each_side(tmp_path, channels, size):
    """Any even number of channels along x will do; an odd one has no middle."""
    geometry = {"nx": 256, "channels_x": channels, "channel_nx": size}
    if channels % 2 == 0 and channels <= 13:
        assert load_camera(mini_camera(tmp_path, **geometry)).detector.channels_x == channels
        return
    with pytest.raises(InputError, match=r"half the columns are read out to each side|channels_x: input should be"):
        load_camera(mini_camera(tmp_path, **geometry))


def test_chips_come_by_number_whatever_the_files_order(tmp_path):
    """The mosaic of the flats' levels is that of the chips' columns and rows."""
    folder = mini_camera(tmp_path)
    text = yaml.safe_load((folder / "chips.yaml").read_text())
    text["chips"]["values"].reverse()
    (folder / "chips.yaml").write_text(yaml.safe_dump(text))
    camera = load_camera(folder)
    assert list(camera.chips) == list(range(1, 31)) and camera.chips[9].filter == "r"
    assert [chip.id for chip in camera.slitless_chips] == sorted(chip.id for chip in camera.slitless_chips)
    assert camera.leds["mosaic"] == (6, 5)


def test_gratings_are_those_of_the_camera_asked_last_or_first(camera, tmp_path):
    """They are kept for the process: another camera has its own, and the first gets its own again."""
    mini, shipped = load_camera(mini_camera(tmp_path)), camera.digest
    assert mini.gratings[29].split < 256 < load_camera().gratings[29].split == 5531
    assert load_camera().gratings[29].split == 5531 and mini.digest != shipped
    assert load_camera(mini.folder).gratings[29].split == mini.gratings[29].split
    (mini.folder / "gratings.yaml").unlink()
    with pytest.raises(InputError, match=r"gratings.yaml: the instrument folder has no gratings"):
        load_camera(mini.folder).gratings  # noqa: B018


def test_what_a_camera_may_lack(tmp_path):
    """Without their files there are no halo, ghosts, lamps, keywords, rays, defects, traps; lists must be one."""
    folder = mini_camera(tmp_path)
    light, charge = ("psf", "scatter", "ghosts", "sky", "leds"), ("cosmic_rays", "defects", "cti", "brighter_fatter")
    for name in (*light, *charge, "level0_keywords"):
        (folder / f"{name}.yaml").unlink()
    bare = load_camera(folder)
    assert bare.psf == bare.scatter == bare.ghosts == bare.sky == bare.leds == {} and bare.keywords == []
    detector = bare.detector
    assert detector.cosmic_rays is detector.defects is detector.traps is None and detector.brighter_fatter == {}
    chips = (folder / "chips.yaml").read_text()
    (folder / "chips.yaml").write_text(chips + "\nmore: []\n")
    with pytest.raises(InputError, match=r"chips.yaml: the file must hold one list, not 2"):
        load_camera(folder)


@pytest.mark.parametrize(("old", "new", "name"), [
    ("\nu:", "\n_u:", "_u"), ("\nu:", "\n5u:", "5u"), ("\nu:", "\nu-1:", "u-1"), ("\nu:", "\nG:", "G"),
    ("\nu:", "\nnuv:", "NUV"), ("\nu:", "\nU_1:", None),
])  # fmt: skip
def test_names_of_filters_name_columns(tmp_path, old, new, name):
    """Each fault alone: a name that is none, and two that differ in case only; the first of them is named."""
    folder = mini_camera(tmp_path)
    path = folder / "filters.yaml"
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    chips = folder / "chips.yaml"
    chips.write_text(chips.read_text().replace("filter: u\n", f"filter: {new.strip()[:-1]}\n"))
    if name is None:
        assert "U_1" in load_camera(folder).filters
        return
    with pytest.raises(InputError, match="not a valid name of a filter") as refused:
        load_camera(folder)
    assert refused.value.key in (name, name.lower()) and str(path) == str(refused.value.file)
