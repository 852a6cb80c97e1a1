"""csstsim show: every kind of file, every option, and refused input."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from click.testing import CliRunner
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from support.commands import refused

from csstsim.catalog.table import ObjectTable
from csstsim.command_line.main import main
from csstsim.io.frames import load_frame, save_frame
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth
from csstsim.report.quicklook.figure import BAD, BOTTOM, FRAME, MIN_WIDTH, TOP, draw
from csstsim.report.quicklook.marks import STYLES
from csstsim.report.quicklook.picture import read_picture

NOISE = np.random.default_rng(2).normal(0.2, 0.05, (30, 40)).astype(np.float32)


def show(*arguments):
    """Run the command; return the PNG's pixels (rows, columns, RGBA)."""
    result = CliRunner().invoke(main, ["show", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return imread(result.output.strip())


@pytest.mark.parametrize("stretch", ["asinh", "log", "linear"])
@pytest.mark.parametrize("kind", ["level0", "render", "readout", "calibrated"])
def test_every_kind_of_file_under_every_stretch(tmp_path, exposure, level0, calibrated, kind, stretch):
    run, job = exposure
    path = {"level0": level0, "calibrated": calibrated(NOISE)}.get(kind) or run.paths.stage(*job.key, f"{kind}.fits")
    pixels = show(path, "--output", tmp_path / "a.png", "--stretch", stretch, "--size", 300)
    assert pixels.shape[0] > 300 and np.ptp(pixels[..., 0]) == 1.0
    picture = read_picture(path)
    unit = {"level0": "DN", "readout": "DN", "render": "electron", "calibrated": "e-/s"}[kind]
    assert picture.unit == unit
    first, second = picture.title.splitlines()
    assert first.startswith("exposure 10100000001, chip ") and "9, r, 150 s, " in first and second == path.name
    assert (picture.wcs is None) == (kind == "readout")


def test_pixels_are_those_of_the_files(exposure, level0):
    run, job = exposure
    assert np.array_equal(read_picture(level0).image, read_level0(level0).assembled())
    path = run.paths.stage(*job.key, "render.fits")
    planes, _ = load_frame(path)
    picture = read_picture(path)
    assert np.allclose(picture.image, planes["image"].astype(float) + planes["counted"], rtol=1e-6) and picture.on_chip
    readout = read_picture(run.paths.stage(*job.key, "readout.fits"))
    assert readout.image.shape > (128, 128) and not readout.on_chip


def test_a_frame_between_stages_says_of_itself_what_the_level0_header_says(exposure, level0):
    run, job = exposure
    frame = read_picture(run.paths.stage(*job.key, "render.fits")).header
    header = read_picture(level0).header
    assert frame == {name: header[name] for name in frame}


def test_a_frame_that_says_nothing_of_itself_is_known_by_its_folder(tmp_path):
    path = tmp_path / "10100000001_07" / "render.fits"
    save_frame(path, {"image": NOISE}, {"stage": "render", "unit": "electron"})
    picture = read_picture(path)
    assert picture.title.startswith("exposure 10100000001, chip 07, render stage") and not picture.on_chip
    assert show(path).size


def test_a_windowed_readout_keeps_the_chips_pixels(tmp_path, windowed):
    picture = read_picture(windowed)
    assert picture.bounds == (20, 70, 30, 110) and picture.wcs is None
    assert np.array_equal(picture.part((25, 26, 40, 42))[:, 0], read_level0(windowed).assembled(full=True)[40:42, 25])
    figure = draw(picture, (30, 50, 40, 60), "linear")
    assert np.allclose(figure.axes[0].get_xlim(), (29.5, 49.5))
    assert np.array_equal(figure.axes[0].images[0].get_array(), picture.image[10:30, 10:30])


def test_overscan_levels_the_channels(windowed):
    """Bias differs by 10 DN from channel to channel; after it the medians agree within the noise (5 DN / sqrt 50)."""
    raw, levelled = (read_picture(windowed, subtract).image for subtract in (False, True))
    channels = [np.s_[:34, 12:28], np.s_[:34, 28:44], np.s_[34:, 12:28], np.s_[34:, 28:44]]
    assert np.ptp([np.median(raw[c]) for c in channels]) > 4
    assert np.abs([np.median(levelled[c]) for c in channels]).max() < 2.5


def test_the_overscans_level_and_not_the_skys_is_subtracted(level0):
    """What is left is the light of sky, dark current and objects: their mean to 1% or half a DN of the bias."""
    budget, gain = read_truth(level0.with_suffix(".truth.parquet")).meta["electrons"], read_level0(level0).gain
    image = read_picture(level0, True).image
    arrived = sum(budget[name] for name in ("light", "dark", "rays", "defects"))
    assert image.mean() == pytest.approx(arrived / image.size / np.mean(list(gain.values())), rel=0.02, abs=0.5)


def test_truth_is_marked_where_it_is(tmp_path, level0):
    """The star and the brighter of the galaxies, each with its marker and colour, on light."""
    from csstsim.report.quicklook.marks import brightest, load_marks

    picture = read_picture(level0)
    marks = brightest(load_marks(level0), picture.bounds, 100)
    figure = draw(picture, picture.bounds, "asinh", marks=marks)
    lines = {line.get_label(): line for line in figure.axes[0].lines if line.get_marker() in "os"}
    assert set(lines) == {"1 star", "2 galaxies"}
    star, galaxies = lines["1 star"], lines["2 galaxies"]
    assert np.allclose(star.get_xydata(), [[30, 40]], atol=0.01)
    assert np.allclose(sorted(galaxies.get_xydata().tolist()), [[60, 60], [90, 95]], atol=0.01)
    assert (star.get_marker(), star.get_mec()) == STYLES["star"] != STYLES["galaxy"]
    drawn = show(level0, "--output", tmp_path / "a.png", "--truth", "--limit", 2)
    for kind in ("star", "galaxy"):
        assert (np.abs(drawn[..., :3] - to_rgb(STYLES[kind][1])).max(axis=-1) < 0.02).any()


@pytest.mark.parametrize(("region", "limit", "expected"), [
    ((50, 128, 50, 128), 1, 1), ((50, 128, 50, 128), 9, 2), ((0, 50, 0, 50), 9, 1), ((100, 128, 0, 20), 9, 0),
])  # fmt: skip
def test_the_brightest_of_the_region_are_marked(tmp_path, level0, monkeypatch, region, limit, expected):
    """The star at (30, 40) is the brightest of the image, but not in a region without it."""
    from csstsim.report.quicklook import show as module

    marked = []
    monkeypatch.setattr(module, "draw", lambda picture, *rest: marked.append(rest[3]) or draw(picture, *rest))
    module.show(level0, tmp_path / "a.png", module.ShowOptions(region=region, truth=True, limit=limit))
    [marks] = marked
    x0, x1, y0, y1 = region
    inside = (marks["x"] >= x0) & (marks["x"] < x1) & (marks["y"] >= y0) & (marks["y"] < y1)
    assert len(marks) == expected and inside.all()


def test_truth_from_elsewhere_on_a_calibrated_file(tmp_path, level0, calibrated):
    path = calibrated(np.random.default_rng(1).normal(size=(128, 128)))
    assert "calibrated.truth.parquet: --truth: no such truth table" in refused("show", path, "--truth")
    table = level0.with_suffix(".truth.parquet")
    show(path, "--truth-table", table)
    assert "no such truth table" in refused("show", path, "--truth-table", tmp_path / "nosuch.parquet")
    assert "not a readable parquet file" in refused("show", path, "--truth-table", path)


def test_a_table_that_is_not_the_truth_of_this_chip(tmp_path, level0):
    truth = ObjectTable.read(level0.with_suffix(".truth.parquet"))
    other = tmp_path / "other.parquet"
    truth.with_columns(ID_chip=np.full(len(truth), 30)).write(other)
    assert "the truth of another chip" in refused("show", level0, "--truth-table", other)
    ObjectTable({name: truth[name] for name in ("obj_type", "ra", "dec")}).write(other)
    assert "xImage" in refused("show", level0, "--truth-table", other)


def test_a_readout_frame_has_no_place_for_the_truth(exposure):
    run, job = exposure
    assert "--truth" in refused("show", run.paths.stage(*job.key, "readout.fits"), "--truth")


def test_pixels_without_a_value_have_a_colour_of_their_own(calibrated):
    image = NOISE.copy()
    path = calibrated(image)
    bad = to_rgb(BAD)

    def count(pixels):
        return (np.abs(pixels[..., :3] - bad).max(axis=-1) < 0.01).sum()

    for stretch in ("asinh", "log", "linear"):
        assert count(show(path, "--stretch", stretch, "--size", 400)) == 0
        image[10:20, 10:20] = np.nan
        assert count(show(calibrated(image), "--stretch", stretch, "--size", 400)) > 0.8 * 100 * 10**2
        path = calibrated(NOISE)
    assert "finite" in refused("show", calibrated(np.full((5, 5), np.nan)))


@pytest.mark.parametrize("stretch", ["asinh", "log", "linear"])
@pytest.mark.parametrize("value", [0.0, 7.0])
def test_a_constant_frame_is_one_grey(calibrated, value, stretch):
    picture = read_picture(calibrated(np.full((6, 9), value)))
    figure = draw(picture, picture.bounds, stretch)
    greys = figure.axes[0].images[0].norm(figure.axes[0].images[0].get_array())
    assert np.ptp(greys) == 0 and 0 < greys[0, 0] < 1


def test_one_pixel_is_a_region(calibrated):
    path = calibrated(NOISE)
    show(path, "--region", 39, 40, 29, 30, "--inset", 39, 29, 1)
    picture = read_picture(path)
    assert draw(picture, (39, 40, 29, 30), "asinh").axes[0].images[0].get_array().tolist() == [[NOISE[29, 39]]]


@pytest.mark.parametrize(
    "region", [(0, 41, 0, 30), (-1, 5, 0, 5), (5, 5, 0, 5), (9, 3, 0, 5), (50, 60, 0, 5), (0, 5, 30, 31)]
)
def test_a_region_outside_is_refused(calibrated, region):
    line = refused("show", calibrated(NOISE), "--region", *region)
    assert "--region" in line and "0 to 40" in line and "0 to 30" in line


@pytest.mark.parametrize(
    "inset, shown", [((20, 15, 10), (15, 25, 10, 20)), ((0, 29, 10), (0, 5, 24, 30)), ((5, 5, 999), (0, 40, 0, 30))]
)
def test_an_inset_is_cut_at_the_edge(calibrated, inset, shown):
    from csstsim.report.quicklook.show import _inset

    picture = read_picture(calibrated(NOISE))
    assert _inset(picture.path, picture.bounds, inset) == shown
    figure = draw(picture, picture.bounds, "asinh", inset=shown)
    closer = next(axes for axes in figure.axes if axes.get_title() == "inset")
    x0, x1, y0, y1 = shown
    assert np.array_equal(closer.images[0].get_array(), NOISE[y0:y1, x0:x1])
    outline = figure.axes[0].patches[-1]
    assert outline.get_xy() == (x0 - 0.5, y0 - 0.5) and (outline.get_width(), outline.get_height()) == (
        x1 - x0,
        y1 - y0,
    )


@pytest.mark.parametrize("inset", [(40, 5, 4), (5, -1, 4), (5, 5, 0)])
def test_an_inset_outside_is_refused(calibrated, inset):
    assert "--inset" in refused("show", calibrated(NOISE), "--inset", *inset)
    assert "--inset" in refused("show", calibrated(NOISE), "--region", 10, 20, 10, 20, "--inset", 5, 15, 4)


def test_limits_and_overscan_that_do_not_fit(calibrated):
    assert "LOW < HIGH" in refused("show", calibrated(NOISE), "--limits", 5, 5)
    assert "--subtract-overscan" in refused("show", calibrated(NOISE), "--subtract-overscan")


def test_limits_are_taken(calibrated):
    picture = read_picture(calibrated(NOISE))
    norm = draw(picture, picture.bounds, "log", (0.1, 0.6)).axes[0].images[0].norm
    assert (norm.vmin, norm.vmax) == (0.1, 0.6)


def test_a_large_frame_is_averaged(calibrated):
    image = np.random.default_rng(1).normal(size=(1200, 500))
    picture = read_picture(calibrated(image))
    shown = draw(picture, picture.bounds, "asinh", side=300).axes[0].images[0]
    assert np.allclose(shown.get_array(), image.reshape(300, 4, 125, 4).mean(axis=(1, 3)), atol=1e-6)
    assert np.allclose(shown.get_extent(), (-0.5, 499.5, -0.5, 1199.5))


@pytest.mark.parametrize("name, kind", [("", np.uint8), ("DQ", np.int32), ("MASK", np.int16)])
def test_a_single_bad_pixel_of_a_mask_is_seen(tmp_path, name, kind):
    """Neither averaged away nor below a background: black is 0, and one hot pixel of 10^6 is far above black."""
    mask, path = np.zeros((1000, 1000), kind), tmp_path / "bad.fits"
    mask[501, 703], mask[:, 44] = 8, 32
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(mask, name=name)]).writeto(path)
    picture = read_picture(path)
    assert picture.bits == 63 and picture.remark == "1001 of 1000000 pixels are not 0 (0.001 of all)"
    axes = draw(picture, picture.bounds, None, side=200).axes
    shown, norm = np.asarray(axes[0].images[0].get_array()), axes[0].images[0].norm
    assert shown.shape == (200, 200) and shown[100, 140] == 8 and np.count_nonzero(shown) == 201
    assert norm(0) == 0.0 and norm(8) == pytest.approx(np.log(9) / np.log(64), abs=1e-6) and norm(63) == 1.0
    assert [label.get_text() for label in axes[1].get_yticklabels()] == ["0", "1", "2", "4", "8", "16", "32"]
    norm = draw(picture, (0, 40, 0, 40), None).axes[0].images[0].norm  # a part without bad pixels: the same limits
    assert (norm.vmin, norm.vmax) == (0, 63)
    assert np.ptp(show(path)[..., 0]) > 0.5


def test_empty_masks_and_integers_that_are_none(tmp_path):
    path = tmp_path / "a.fits"
    for image, bits in ((np.zeros((5, 6), np.uint8), 1), (np.full((5, 6), 300, np.int16), None)):
        fits.PrimaryHDU(image).writeto(path, overwrite=True)
        assert read_picture(path).bits == bits and show(path).size


@pytest.mark.parametrize("shape, pixels", [((30, 40), 7), ((300, 300), 1), ((301, 301), 1), ((1200, 900), 1)])
def test_a_mean_is_drawn_on_whole_pixels_of_the_picture(calibrated, shape, pixels):
    """Figure pixels along a mean of 1, 1, 2 and 4 chip pixels, where 300 are to be had."""
    picture = read_picture(calibrated(np.random.default_rng(1).normal(size=shape)))
    axes = draw(picture, picture.bounds, "asinh", side=300).axes[0]
    step = -(-max(shape) // 300)
    assert np.allclose(axes.get_window_extent().size, np.array(shape[::-1]) / step * pixels)


def test_a_calibrated_window_counts_its_pixels_on_the_chip(calibrated):
    cards = {"READX0": 101, "READX1": 140, "READY0": 11, "READY1": 40}
    picture = read_picture(calibrated(NOISE, **cards))
    assert picture.bounds == (100, 140, 10, 40)
    assert np.allclose(picture.wcs.all_pix2world(119.5, 24.5, 0), (60.0, -40.0))  # CRPIX (20.5, 15.5) of the array


def test_files_that_cannot_be_shown(tmp_path, level0):
    text = tmp_path / "text.fits"
    text.write_text("no FITS")
    table = tmp_path / "table.fits"
    Table({"a": [1]}).write(table)
    cube = tmp_path / "cube.fits"
    fits.PrimaryHDU(np.zeros((2, 3, 4))).writeto(cube)
    cut = tmp_path / "cut.fits"
    cut.write_bytes(level0.read_bytes()[:-5000])
    for path, word in (
        (tmp_path / "nosuch.fits", "no such file"), (tmp_path, "no such file"), (text, "not a readable FITS file"),
        (table, "no extension holds a 2-d image"), (cube, "no extension holds a 2-d image"), (cut, "cut short"),
    ):  # fmt: skip
        line = refused("show", path)
        assert str(path) in line and word in line
        assert not path.with_suffix(".png").exists()


def test_any_fits_image_is_shown(tmp_path):
    path = tmp_path / "plain.fits"
    fits.PrimaryHDU(np.arange(12, dtype=np.int16).reshape(3, 4)).writeto(path)
    assert show(path).size
    assert read_picture(path).title == "image\nplain.fits"
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(NOISE, name="SCI")]).writeto(path, overwrite=True)
    assert read_picture(path).image.shape == NOISE.shape


def test_where_the_png_goes(tmp_path, calibrated):
    path = calibrated(NOISE)
    show(path)
    first = path.with_suffix(".png").read_bytes()
    show(path, "--stretch", "linear")
    assert path.with_suffix(".png").read_bytes() != first  # a PNG may be replaced
    other = tmp_path / "notes.png"
    other.write_text("not a PNG")
    assert "is not a PNG" in refused("show", path, "--output", other) and other.read_text() == "not a PNG"
    assert "ends with .png" in refused("show", path, "--output", path)
    assert refused("show", path, "--output", tmp_path / "calibrated.fits" / "a.png")
    folder = tmp_path / "folder.png"
    folder.mkdir()
    assert str(folder) in refused("show", path, "--output", folder)


def test_a_file_with_a_wrong_checksum_is_shown_with_a_word(tmp_path, level0, caplog):
    damaged = tmp_path / level0.name
    damaged.write_bytes(level0.read_bytes())
    show(damaged, "--output", tmp_path / "good.png", "--size", 300)
    assert not caplog.messages
    with fits.open(damaged, mode="update", checksum=False) as file:
        file[0].header["OBJECT"] = "another"
    show(damaged, "--output", tmp_path / "bad.png", "--size", 300)
    assert any("wrong CHECKSUM of HDU primary" in message for message in caplog.messages)


@pytest.mark.parametrize("cards", [{"BSCALE": 0.1, "BZERO": 3.0}, {"BZERO": 32768}, {"BLANK": -32768}])
def test_scaled_images_are_shown_with_their_values(tmp_path, cards):
    hdu = fits.PrimaryHDU(np.arange(600, dtype=np.int16).reshape(20, 30))
    for keyword, value in cards.items():
        hdu.header[keyword] = value
    hdu.writeto(tmp_path / "scaled.fits")
    assert np.array_equal(read_picture(tmp_path / "scaled.fits").image, fits.getdata(tmp_path / "scaled.fits"))
    assert show(tmp_path / "scaled.fits").shape[2] == 4


@pytest.mark.parametrize("name", [".", "..", "none.fits"])
def test_what_is_no_file_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert "no such file" in refused("show", name)


def test_a_figure_says_what_it_shows(calibrated):
    """An oblong part in blocks of 3 x 3, whose last columns lie beyond it, with an inset: pixels, places, words."""
    image = np.random.default_rng(8).normal(50.0, 5.0, (30, 40)).astype(np.float32)
    image[20:24, 30:36] += 500.0
    picture = read_picture(calibrated(image, BUNIT="electron"))
    figure = draw(picture, (3, 38, 2, 29), "linear", inset=(30, 36, 20, 24), side=12)
    axes, bar, closer, its_bar = figure.axes
    shown = axes.images[0]
    assert np.asarray(shown.get_array())[:, :11] == pytest.approx(
        image[2:29, 3:36].reshape(9, 3, 11, 3).mean(axis=(1, 3)), rel=1e-5
    )
    last = image[2:29, 36:38].reshape(9, 6).mean(axis=1)  # of two columns
    assert np.asarray(shown.get_array())[:, 11] == pytest.approx(last, rel=1e-5)
    assert shown.get_extent() == [2.5, 38.5, 1.5, 28.5] and axes.get_xlim() == (2.5, 37.5)
    assert axes.get_ylim() == (1.5, 28.5) and closer.get_xlim() == (29.5, 35.5) and closer.get_ylim() == (19.5, 23.5)
    assert closer.images[0].norm.vmin > 400 > shown.norm.vmin  # limits of its own
    assert bar.get_ylabel() == its_bar.get_ylabel() == "electron"
    assert [axes.coords[k].get_axislabel() for k in (0, 1)] == ["x [px]", "y [px]"]
    title, remark = figure.texts[:2]
    assert title.get_text() == picture.title and remark.get_text() == picture.remark
    assert title.get_position()[1] > 0.9 and remark.get_position()[1] < 0.1
    assert to_rgb(axes.patches[-1].get_edgecolor()) == to_rgb(closer.spines["left"].get_edgecolor()) == to_rgb(FRAME)
    width, height = figure.get_size_inches()
    assert width == MIN_WIDTH and height == pytest.approx(BOTTOM + 0.27 / 3 + TOP, abs=0.02)


def test_an_image_without_a_unit_and_not_of_the_chip(tmp_path):
    path = tmp_path / "frame.fits"
    save_frame(path, {"image": NOISE}, {"stage": "readout"})
    picture = read_picture(path)
    figure = draw(picture, picture.bounds, None)
    axes, bar = figure.axes[:2]
    assert bar.get_ylabel() == "unit not given" and axes.coords[1].get_axislabel() == "y [px of the frame]"


def test_marks_are_on_the_inset_too_and_counted_in_the_legend(level0):
    from csstsim.report.quicklook.marks import brightest, legend_title, load_marks

    picture = read_picture(level0)
    marks = brightest(load_marks(level0), picture.bounds, 3)
    figure = draw(picture, picture.bounds, "asinh", marks=marks, inset=(20, 50, 30, 60), side=200)
    closer = next(axes for axes in figure.axes if axes.get_title() == "inset")
    labels = [line.get_label() for line in closer.lines]
    assert labels == ["1 star", "2 galaxies"]
    (legend,) = figure.legends
    assert legend.get_title().get_text() == legend_title(marks) and legend_title(marks).startswith("truth, brightest 3")
    assert [text.get_text() for text in legend.get_texts()] == labels


def test_a_laboratory_map_says_its_statistics(tmp_path):
    path = tmp_path / "map.fits"
    image = np.array([[0.5, 1.5, np.nan], [1.0, 3.0, 1.0]])
    hdu = fits.PrimaryHDU(image)
    hdu.header["DATAMAX"] = 3.0
    hdu.writeto(path)
    rms = np.sqrt(np.mean((np.array([0.5, 1.5, 1.0, 3.0, 1.0]) - 1.4) ** 2))
    assert read_picture(path).remark == f"mean 1.4, rms {rms:.3g}, from 0.5 to 3"


@pytest.mark.parametrize(("cards", "label"), [({}, "RA"), ({"POSKIND": "APPARENT"}, "RA (apparent)")])
def test_the_grid_says_whether_places_are_apparent(calibrated, cards, label):
    picture = read_picture(calibrated(NOISE, **cards))
    figure = draw(picture, picture.bounds, "asinh")
    lon, lat = figure.axes[0]._all_coords[1]
    assert (lon.get_axislabel(), lat.get_axislabel()) == (label, label.replace("RA", "Dec"))


def test_a_wrong_checksum_is_said_behind_the_remark(tmp_path, level0, monkeypatch):
    from csstsim.report.quicklook import show as module

    damaged, seen = tmp_path / level0.name, []
    damaged.write_bytes(level0.read_bytes())
    with fits.open(damaged, mode="update", checksum=False) as file:
        file[0].header["OBJECT"] = "another"
    monkeypatch.setattr(module, "draw", lambda picture, *rest: seen.append((picture, *rest)) or draw(picture, *rest))
    options = module.ShowOptions(region=(10, 70, 20, 90), inset=(60, 30, 12), size=200, limits=(400.0, 900.0))
    module.show(damaged, tmp_path / "a.png", options)
    ((picture, bounds, stretch, limits, marks, inset, size),) = seen
    assert picture.remark.endswith("(wrong CHECKSUM of HDU primary: the file was changed or is damaged)")
    assert (bounds, stretch, limits, marks, size) == ((10, 70, 20, 90), None, (400.0, 900.0), None, 200)
    assert inset == (54, 66, 24, 36)


def test_the_first_image_of_a_file_is_shown_with_its_origin_and_unit(tmp_path):
    """Tables and cubes before it are passed over; cards of HDU 0 hold unless its own say otherwise."""
    path = tmp_path / "several.fits"
    primary = fits.PrimaryHDU()
    primary.header.update({"OBSID": "42", "FILTER": "g", "BUNIT": "DN"})
    images = [
        fits.ImageHDU(np.zeros((2, 3, 4)), name="CUBE"),
        fits.ImageHDU(NOISE, name="WHT"),
        fits.ImageHDU(2 * NOISE),
    ]
    images[1].header.update({"FILTER": "r", "BUNIT": "1/s"})
    fits.HDUList([primary, *images]).writeto(path)
    picture = read_picture(path)
    assert np.array_equal(picture.image, NOISE) and (picture.kind, picture.unit) == ("extension WHT", "1/s")
    assert picture.title == "exposure 42, r, extension WHT\nseveral.fits" and picture.origin == (0, 0)
