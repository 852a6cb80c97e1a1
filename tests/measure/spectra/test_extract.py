"""Extraction of known spectra of stars and galaxies, rendered slab by slab with numpy.

The deterministic frames have no noise, but its variance is assumed for the weights: they show errors of method.
"""

from dataclasses import replace

import numpy as np
import pytest
from measure import slitless
from measure.slitless import LIGHT, GaussianPsf, draw, frame_of, setting, sources_of, window_about

from csstsim.base.units import ab_photon_density
from csstsim.instrument.filter import GRID
from csstsim.measure.calibration.bad_pixels import BAD, FULL
from csstsim.measure.spectra import chosen_orders
from csstsim.measure.spectra.extract import extract_spectra
from csstsim.measure.spectra.line_profile import ACROSS, ALONG, OFFSETS, Shapes, broadened, psf_profile
from csstsim.measure.spectra.spectrum_columns import (
    COLUMNS,
    CONTAMINATED,
    COSMIC,
    CUT,
    DIM,
    EDGE,
    LOST,
    MASKED,
    SATURATED,
)
from csstsim.optics.scatter.scattered_light import read_scattered

LINES = {"GU": 3500.0, "GV": 5200.0, "GI": 8000.0}
PSF = GaussianPsf()


def smooth(level=0.5):
    return level * 6000.0 / GRID


def first_orders(s):
    return np.flatnonzero(s.orders["order"] == 1)


@pytest.fixture(scope="module")
def star(camera):
    """One star of GV: (setting, expected image, sources)."""
    window = window_about(2000.3, 4000.27, 1, (500, 1000))
    s, image = setting(camera, 2, window, [(2000.3, 4000.27)]), np.zeros(window.shape)
    draw(image, window, s.gratings, s.orders, smooth(), first_orders(s)[0])
    return s, image, sources_of([smooth()])


def run(setting_, frame, sources, **choice):
    return extract_spectra(frame, setting_.orders, sources, setting_.model, PSF, choice=chosen_orders.Choice(**choice))


@pytest.mark.parametrize(("chip", "x", "side"), [(3, 2000.3, 1), (3, 6000.4, -1), (2, 1500.1, 1), (2, 5000.7, -1),
                                                 (1, 2500.2, 1), (1, 7000.6, -1)])  # fmt: skip
def test_flux_line_and_resolution_of_both_gratings(camera, chip, x, side):
    name, y = camera.chips[chip].filter, 4000.27
    line = LINES[name]
    spectrum = smooth() + 40.0 * np.exp(-0.5 * ((GRID - line) / 1.5) ** 2)  # FWHM 3.5 angstrom: unresolved
    window = window_about(x, y, side)
    s, image = setting(camera, chip, window, [(x, y)]), np.zeros(window.shape)
    draw(image, window, s.gratings, s.orders, spectrum, first_orders(s)[0])
    table = run(s, frame_of(image, window), sources_of([spectrum]))
    given = image.sum() / LIGHT
    assert table["box"].sum() == pytest.approx(given, rel=1e-3)
    assert table["electrons"].sum() == pytest.approx(given, rel=3e-3)
    assert table["model"].sum() == pytest.approx(given, rel=1e-3)
    lit = (table["flags"] == 0) & (np.abs(table["wavelength"] - line) > 100)
    assert lit.sum() > 250
    true = np.interp(table["wavelength"], GRID, spectrum)
    assert np.abs(table["flux"] / true - 1)[lit].max() < 0.01
    # 1 photon / s / m2 / angstrom of lambda angstrom is 1.986e-12 / lambda erg / s / cm2 / angstrom
    assert table["flux_erg"][lit] == pytest.approx(
        table["flux"][lit] * 1.986446e-12 / table["wavelength"][lit], rel=1e-5, abs=0
    )

    near = np.abs(table["wavelength"] - line) < 60
    wave, light = table["wavelength"][near], (table["box"] / table["sensitivity"])[near]
    light = light - np.interp(wave, GRID, smooth())
    centroid = (wave * light).sum() / light.sum()
    pixel = abs(np.diff(table["wavelength"]).mean())
    assert abs(centroid - line) < 0.1 * pixel
    spread = np.sqrt(((wave - centroid) ** 2 * light).sum() / light.sum())
    assert line / (2.355 * spread) > 200
    # of the star (1 px), the pixel, the line
    assert spread == pytest.approx(np.hypot(1.5, pixel * np.sqrt(slitless.SIGMA**2 + 1 / 12)), rel=0.03)


def test_pulls_have_width_one_and_the_optimal_is_the_better(star):
    s, image, sources = star
    pulls, boxes, ratio = [], [], []
    faint = 0.1  # sky and read noise count for as much as the star
    sources = sources_of([smooth(0.05)])
    for seed in range(25):
        table = run(s, frame_of(faint * image, s.window, seed), sources, snr_min=0.0)
        good = table["flags"] & ~DIM == 0
        pulls.append(((table["electrons"] - table["model"]) / table["electrons_err"])[good])
        boxes.append(((table["box"] - table["model"]) / table["box_err"])[good])
        ratio.append((table["electrons_err"] / table["box_err"])[good])
    pulls, boxes = np.concatenate(pulls), np.concatenate(boxes)
    assert len(pulls) > 9000  # 1% on a width
    assert pulls.std() == pytest.approx(1.0, abs=0.04)
    assert boxes.std() == pytest.approx(1.0, abs=0.04)
    assert abs(boxes.mean()) < 0.06  # sky of a block is shared: 25 x 9 of them, each 0.3 sigma
    assert abs(pulls.mean()) < 0.06
    assert np.mean(ratio) < 0.95


def test_sloping_sky(star):
    s, image, sources = star
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    sky = 20.0 + 0.3 * y + 0.03 * x
    table = run(s, frame_of(image, s.window, sky=sky), sources)
    assert table["box"] == pytest.approx(table["model"], abs=0.01 * float(table["model"].max()))
    assert table["box"].sum() == pytest.approx(image.sum() / LIGHT, rel=1e-3)


def test_a_neighbour_is_subtracted_and_said(camera):
    positions = [(2000.3, 4000.27), (2040.8, 4002.9)]  # 2.6 px across the trace: blended
    window = window_about(*positions[0], 1, (500, 1000))
    s, image = setting(camera, 2, window, positions), np.zeros(window.shape)
    for k, level in zip(first_orders(s), (0.5, 0.3), strict=True):
        draw(image, window, s.gratings, s.orders, smooth(level), k)
    sources = sources_of([smooth(0.5), smooth(0.3)])
    others = s.model.image(s.orders, sources.shapes, sources.spectra, sources.edges, window)
    assert others.sum() == pytest.approx(image.sum(), rel=2e-3)
    assert np.abs(others - image).max() < 0.03 * image.max()  # linear between eighths of a pixel
    plain = run(s, frame_of(image, window), sources)
    table = run(s, frame_of(image, window, others=others), sources)
    mine, before = table["id"] == 100, plain["id"] == 100
    # The neighbour's rows that do not fit the star's profile are rejected; what is left is still wrong
    assert plain["box"][before].sum() > 1.04 * plain["model"][before].sum()
    assert np.isnan(plain["contamination"]).all()
    for name in ("box", "electrons"):
        assert table[name][mine].sum() == pytest.approx(table["model"][mine].sum(), rel=5e-3)
    middle = mine & (table["flags"] & DIM == 0)
    assert (table["flags"][middle] & CONTAMINATED > 0).mean() > 0.8
    assert (table["contamination"][middle] > 0).mean() > 0.9


def test_zeroth_order_of_another_object_is_contamination_and_can_be_extracted(camera):
    positions = [(2000.3, 4000.27), (2700.4, 4000.27)]
    window = window_about(*positions[0], 1, (500, 1000))
    s, image = setting(camera, 2, window, positions), np.zeros(window.shape)
    rows = list(zip(s.orders["row"].tolist(), s.orders["order"].tolist(), strict=True))
    draw(image, window, s.gratings, s.orders, smooth(), rows.index((0, 1)))
    spot = np.zeros(window.shape)
    draw(spot, window, s.gratings, s.orders, smooth(), rows.index((1, 0)))
    image += spot
    sources = sources_of([smooth(), smooth()])
    kept = s.orders.take([rows.index((0, 1)), rows.index((1, 0))])
    s.orders = kept
    others = s.model.image(kept, sources.shapes, sources.spectra, sources.edges, window)
    table = run(s, frame_of(image, window, others=others), sources)
    struck = np.abs(table["column"] - 2708) < 4
    assert (table["flags"][struck] & CONTAMINATED > 0).any()
    assert table["contamination"].sum() == pytest.approx(spot.sum() / LIGHT, rel=0.1)
    assert table["box"][struck].sum() == pytest.approx(table["model"][struck].sum(), rel=0.02)
    zero = run(s, frame_of(spot, window), sources, orders=(0,))
    assert set(zero["order"]) == {0} and set(zero["id"]) == {101}
    assert zero["box"].sum() == pytest.approx(spot.sum() / LIGHT, rel=5e-3)


def test_cosmic_rays_bad_and_saturated_pixels(star):
    s, image, sources = star
    frame = frame_of(image, s.window, 3)
    clean = run(s, frame, sources)
    row, light = 47, clean["model"].max()
    hits = [60, 61, 200, 333]
    electrons, marks = frame.electrons.copy(), frame.marks.copy()
    electrons[row - 1, hits] += 3 * light
    electrons[row + 3, 200] += 900.0
    electrons[row, 120], marks[row, 130] = np.nan, BAD
    electrons[row - 2 : row + 3, 250], marks[row - 2 : row + 3, 250] = 9e4, FULL
    table = run(s, replace(frame, electrons=electrons, marks=marks), sources)
    column = table["column"] - s.window.x0
    for hit, flag in [*((h, COSMIC) for h in hits), (120, MASKED), (130, MASKED), (250, SATURATED)]:
        at = int(np.flatnonzero(column == hit)[0])
        assert table["flags"][at] & flag
        if flag == SATURATED:  # the core is lost: too little is left
            assert table["flags"][at] & LOST and np.isnan(table["electrons"][at])
            continue
        pull = (table["electrons"] - table["model"])[at] / table["electrons_err"][at]
        assert abs(pull) < 4.5
    elsewhere = ~np.isin(column, [*hits, 120, 130, 250])
    assert (table["flags"][elsewhere] & COSMIC > 0).mean() < 0.01
    changed = np.abs(table["electrons"] - clean["electrons"])[elsewhere & np.isfinite(table["electrons"])]
    assert changed.max() < 0.5 * np.median(clean["electrons_err"])


def test_edge_of_the_window(camera, star):
    _, image, sources = star
    whole = window_about(2000.3, 4000.27, 1, (500, 1000))
    s = setting(camera, 2, whole, [(2000.3, 4000.27)])
    # The last columns, and the rows from 2.8 px below the trace on, are lost
    cut = slice(45, None), slice(0, 300)
    window = type(whole)(whole.x0, whole.x0 + 300, whole.y0 + 45, whole.y1)
    table = run(s, frame_of(image[cut], window), sources)
    assert table["column"].max() == window.x1 - 1
    assert (table["flags"] & EDGE > 0).all()
    lit = table["flags"] & DIM == 0
    assert np.abs(table["electrons"] / table["model"] - 1)[lit].max() < 0.01
    above = type(whole)(whole.x0, whole.x1, whole.y0 + 50, whole.y1)  # the trace is 2 px outside
    table = run(s, frame_of(image[50:], above), sources)
    assert len(table) == 0


def test_flat_field_losses_are_in_the_noise(star):
    s, image, sources = star
    plain = run(s, frame_of(image, s.window), sources)
    table = run(s, frame_of(image, s.window, response=0.5), sources)
    assert table["electrons"] == pytest.approx(plain["electrons"], rel=1e-3, abs=1.0)
    ratio = table["box_err"] / plain["box_err"]
    assert (ratio > np.sqrt(2.0)).all() and (ratio < 2.0).all()  # photons by sqrt(2), read noise by 2


def test_choice_and_nothing(star):
    s, image, sources = star
    frame = frame_of(image, s.window)
    assert len(run(s, frame, sources, snr_min=1e9)) == 0
    assert run(s, frame, sources).meta["spectra"] == 1
    empty = extract_spectra(frame, s.orders.take(slice(0, 0)), sources, s.model, PSF)
    assert len(empty) == 0 and set(empty) == set(COLUMNS)
    for blind in ({"electrons": np.full_like(frame.electrons, np.nan)}, {"marks": np.full_like(frame.marks, BAD)}):
        table = run(s, replace(frame, **blind), sources)
        assert len(table) == 0 and table.meta["left_out"]["unusable"] == 1
    known = replace(sources, spectra=None)
    assert np.isnan(run(s, frame, known)["model"]).all()


def test_keywords_of_before_work_and_say_what_to_give(star):
    s, image, sources = star
    given = frame_of(image, s.window), s.orders, sources, s.model, PSF
    with pytest.warns(DeprecationWarning, match=r"choice=Choice"):
        old = extract_spectra(*given, wanted=(1, 2), snr_min=0.0, ids=[int(s.orders["id"][0])])
    new = run(s, given[0], sources, orders=(1, 2), snr_min=0.0, ids=[int(s.orders["id"][0])])
    assert set(old["order"]) >= {1} and all(np.array_equal(old[name], new[name], equal_nan=True) for name in COLUMNS)
    with pytest.raises(ValueError, match="snr_max"), pytest.warns(DeprecationWarning):
        extract_spectra(*given, snr_max=3)


def test_result_travels_through_a_file(star, tmp_path):
    s, image, sources = star
    table = run(s, frame_of(image, s.window), sources)
    table.write(tmp_path / "spectra.parquet")
    assert type(table).read(tmp_path / "spectra.parquet") == table


def test_collapsed_galaxies_against_galsim():
    import galsim

    for index, components in ((1.0, (1.0, 0.0)), (4.0, (0.0, 1.0))):
        shape = galsim.Shear(g1=0.3, g2=0.2)
        matrix = shape.getMatrix()
        shapes = Shapes.of(matrix[None], np.array([components]), np.array([[3.0, 3.0]]))
        point = psf_profile(PSF.at(0, 0), 2, ACROSS)
        profile = broadened(point, shapes.fraction[0], shapes.radius[0, ACROSS])[0]
        galaxy = galsim.Sersic(n=index, half_light_radius=3.0).shear(shape)
        image = galsim.Convolve(galaxy, galsim.Gaussian(sigma=slitless.SIGMA)).drawImage(nx=401, ny=401, scale=1.0)
        lines = LIGHT * image.array.sum(axis=1, dtype=float)
        edges = np.arange(-12, 14) - 0.5
        ours = np.diff(np.interp(edges, OFFSETS, profile))
        assert ours == pytest.approx(lines[200 - 12 : 200 + 13], abs=4e-3 * lines.max())


def test_flux_of_an_ab_star(camera, star):
    """A star of 20 mag through GV gives back its AB magnitude, whatever it was rendered with."""
    s, image, _ = star
    spectrum = ab_photon_density(GRID, 20.0)
    image = np.zeros(image.shape)
    draw(image, s.window, s.gratings, s.orders, spectrum, first_orders(s)[0])
    table = run(s, frame_of(image, s.window), sources_of([spectrum]))
    lit = table["flags"] == 0
    nu = 2.99792458e18 / table["wavelength"]
    f_nu = table["flux_erg"] * table["wavelength"] / nu
    assert np.abs(-2.5 * np.log10(f_nu[lit]) - 48.6 - 20.0).max() < 0.011


def test_collapsed_psf_has_all_the_light_of_box_and_wing(psf_r):
    """Against pixels summed in two dimensions, out to where the profile is summed."""
    wing = read_scattered(psf_r).wing
    cells = psf_r.at(4000.0, 4000.0)
    profile = psf_profile(cells, psf_r.oversampling, ACROSS, wing)
    half = cells.shape[-1] / 2 / psf_r.oversampling
    x, y = np.arange(-511.5, 512), np.arange(-63.5, 64)
    light = wing.profile(np.hypot(x, y[:, None]))
    light[:, (np.abs(y)[:, None] < half) & (np.abs(x) < half)] = 0.0
    total = cells.sum(axis=(1, 2)) + light.sum(axis=(1, 2))
    assert profile[:, -1] == pytest.approx(total, abs=5e-4)
    assert (np.diff(profile, axis=1) > -1e-5).all()
    inner = np.abs(y) < 10
    rows = slice(int((half - 10) * psf_r.oversampling), int((half + 10) * psf_r.oversampling))
    middle = np.searchsorted(OFFSETS, [-10.0, 10.0])
    share = cells[:, rows].sum(axis=(1, 2)) + light[:, inner].sum(axis=(1, 2))
    assert profile[:, middle[1]] - profile[:, middle[0]] == pytest.approx(share, abs=2e-4)


def test_a_spectrum_that_the_window_cuts_is_counted(star):
    s, image, sources = star
    orders = s.orders
    for missing, cut in ((0.0, 0), (2.0, 0), (4.0, 1)):  # px of the order
        s.orders = orders.with_columns(wave_max=orders["wave_max"] - missing / np.abs(orders["q"]))
        about = run(s, frame_of(image, s.window), sources).meta
        assert (about["spectra"], about["cut"]) == (1, cut)
    s.orders = orders


def test_a_line_is_chosen_as_a_line(camera):
    """A galaxy that is all line: its light over the whole order is far below the limit, that of the line is not."""
    x, y, line = 2000.3, 4000.27, LINES["GV"]
    window = window_about(x, y, 1)
    spectrum = 12.0 * np.exp(-0.5 * ((GRID - line) / 4.0) ** 2)
    s, image = setting(camera, 2, window, [(x, y)]), np.zeros(window.shape)
    draw(image, window, s.gratings, s.orders, spectrum, first_orders(s)[0])
    orders = s.orders.with_columns(drawn=np.where(s.orders["order"] == 1, image.sum(), s.orders["drawn"]))
    frame, sources = frame_of(image, window, sky=60.0), sources_of([spectrum])
    mean = chosen_orders.predicted_snr(orders, sources.shapes, frame.noise)[first_orders(s)[0]]
    peak = chosen_orders.line_snr(orders.take(first_orders(s)), sources, s.model, frame.noise)[0]
    assert mean < 5.0 < peak
    # all the line's light in sqrt(element x rows) pixels of sky: the bound that an element of three pixels comes near
    assert (
        peak
        < image.sum() / np.sqrt(image.sum() + chosen_orders.ELEMENT * chosen_orders.ELEMENT_ROWS * frame.noise**2)
        < 4 * peak
    )
    chosen, left = chosen_orders.chosen_orders(frame, orders, sources, s.model)
    assert chosen.sum() == 1 and left["faint"] == 0
    without, left = chosen_orders.chosen_orders(frame, orders, replace(sources, spectra=None), s.model)
    assert not without.any() and left["faint"] == 1


def test_what_is_left_out_is_counted(star):
    s, image, sources = star
    table = run(s, frame_of(image, s.window), sources, snr_min=1e9)
    assert table.meta["spectra"] == 0 and table.meta["left_out"]["faint"] == 1 and len(table) == 0
    ids = s.orders["id"][:1]
    assert run(s, frame_of(image, s.window), sources, ids=ids).meta["spectra"] == 1
    assert run(s, frame_of(image, s.window), sources, ids=ids + 99).meta["spectra"] == 0
    dark = s.orders.with_columns(drawn=np.zeros(len(s.orders)))
    table = extract_spectra(frame_of(image, s.window), dark, sources, s.model, PSF)
    assert table.meta["left_out"] == {"off": 1, "second": 0, "faint": 0, "unusable": 0}


def test_the_psf_of_a_spectrum_is_that_of_the_objects_own_position(star):
    """Where the grating does not disperse its light; on the chip, if it is beside it."""
    s, image, sources = star
    asked = []

    class Recorder(GaussianPsf):
        def at(self, x, y):
            asked.append((x, y))
            return super().at(x, y)

    for x, at in ((2000.3, 2000.3), (-30.0, 0.0)):
        orders = s.orders.with_columns(x=np.full(len(s.orders), x), p=s.orders["p"] + 2000.3 - x)
        extract_spectra(frame_of(image, s.window), orders, sources, s.model, Recorder())
        assert set(asked) == {(at, 4000.27)}
        asked.clear()


def test_light_that_its_grating_cuts_is_flagged_and_errors_are_in_the_unit_of_the_flux(star):
    s, image, sources = star
    plain = run(s, frame_of(image, s.window), sources)
    cut = extract_spectra(
        frame_of(image, s.window), s.orders.with_columns(cut=np.ones(len(s.orders), bool)), sources, s.model, PSF
    )
    assert not (plain["flags"] & CUT).any() and (cut["flags"] & CUT > 0).all()
    lit = plain["flags"] & DIM == 0
    for value in ("flux", "flux_err"):
        electrons = plain["electrons" + value.removeprefix("flux")]
        assert plain[value][lit] * plain["sensitivity"][lit] == pytest.approx(electrons[lit], rel=1e-5)


@pytest.mark.parametrize(("along", "across"), [(5.0, 0.3), (0.3, 5.0)])
def test_a_long_galaxy_has_its_size_along_and_across_the_trace(star, along, across):
    """A disk with a line, rendered by the model: the electrons of every column are those expected of it."""
    s, _, _ = star
    spectrum = smooth() + 20.0 * np.exp(-0.5 * ((GRID - 5200.0) / 4.0) ** 2)
    sources = sources_of([spectrum])
    sources.shapes.radius[0, ALONG, 0], sources.shapes.radius[0, ACROSS, 0] = along, across
    first = s.orders.take(first_orders(s))
    image = s.model.image(first, sources.shapes, sources.spectra, sources.edges, s.window)
    table = run(s, frame_of(image, s.window), sources)
    lit = table["flags"] & ~(CONTAMINATED | COSMIC) == 0
    assert lit.sum() > 250
    off = np.abs(table["electrons"] - table["model"])[lit]
    assert off.max() < 0.03 * table["model"].max() and off.sum() < 0.02 * table["model"][lit].sum()


def test_the_noise_of_a_frame_is_that_of_its_good_pixels(star):
    """Half of them are defects of 9000 electrons, some have no value."""
    s, image, _ = star
    frame = frame_of(0 * image, s.window)
    electrons, marks = frame.electrons.copy(), frame.marks.copy()
    marks[:, ::16], electrons[:, ::16], electrons[::16, 8::16] = BAD, 9000.0, np.nan
    found = replace(frame, electrons=electrons, marks=marks)
    assert found.noise == pytest.approx(np.sqrt(slitless.SKY + slitless.READ_NOISE**2), rel=1e-5)
    assert found.faintest == pytest.approx(0.1 * found.noise)
