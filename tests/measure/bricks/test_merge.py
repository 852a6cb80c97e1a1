"""Merging: photometry of repeated visits, pairs, credible sources, rows without a measurement, the file."""

import healpy
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.csst import BANDS
from support.measured_table import ARCSEC, table

from csstsim.base import healpix, sphere
from csstsim.base.rng import stream
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.associate import FLOOR
from csstsim.measure.bricks.merge import _skewed_mean, merge_brick, write_merged


def visits(ra, dec, seed, count=4, scatter=0.02):
    """`count` frames of the same sources, each shifted by `scatter` arcsec (rms per axis)."""
    rng = stream(seed, "visits")
    v = sphere.unit_vectors(ra, dec)
    frames = []
    for k in range(count):
        moved = v + np.radians(scatter * ARCSEC) * rng.normal(size=v.shape)
        band = "ugri"[k % 4]
        snr = rng.uniform(5, 50, len(ra))
        frames.append(table(*sphere.ra_dec(moved), obsid=str(k + 1), chip=8 + k, band=band, snr=snr))
    return frames


def test_photometry_of_two_visits_is_the_weighted_mean():
    ra, dec = [150.0], [2.0]
    pix = int(healpix.brick_of(150.0, 2.0))
    one = table(ra, dec, obsid="1", flux=1000.0, zeropoint=30.0)
    two = table(ra, dec, obsid="2", flux=4400.0, zeropoint=31.5)  # 3.981 times as deep
    nuv = table(ra, dec, obsid="3", band="NUV", flux=-20.0)
    sources, found = merge_brick(pix, [one, two, nuv], BANDS)
    scale = 10 ** (0.4 * 1.5)
    weights = np.array([1 / 50.0**2, 1 / (50.0 / scale) ** 2])
    mean = (weights * [1000.0, 4400.0 / scale]).sum() / weights.sum()
    assert sources["flux_g"][0] == pytest.approx(mean * 10 ** (0.4 * (23.9 - 30.0)))
    assert sources["mag_g"][0] == pytest.approx(30.0 - 2.5 * np.log10(mean))
    assert sources["mag_err_g"][0] == pytest.approx(2.5 / np.log(10) * weights.sum() ** -0.5 / mean)
    assert sources["flux_nuv"][0] < 0 and np.isnan(sources["mag_nuv"][0]) and sources["n_nuv"][0] == 1
    assert np.isnan(sources["flux_y"][0]) and sources["n_y"][0] == 0
    assert sources["flags"][0] == 3 and sources["n_g"][0] == 2 and len(found) == 3
    assert sources["source_id"][0] >> 20 == pix


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-300, 3000), st.floats(1, 500), st.sampled_from(BANDS)), min_size=1, max_size=12),
    st.lists(st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -5.0]), max_size=3),
)
def test_fluxes_are_inverse_variance_means_of_all_that_was_measured(visits, unusable):
    """Against the sums written out; negative fluxes count, unusable errors and fluxes do not."""
    pix = int(healpix.brick_of(150.0, 2.0))
    tables = [
        table([150.0], [2.0], obsid=str(k), band=band, flux=flux, zeropoint=23.9).with_columns(
            flux_psf_err=np.array([error])
        )
        for k, (flux, error, band) in enumerate(visits)
    ]
    for k, value in enumerate(unusable):
        odd = table([150.0], [2.0], obsid=f"odd{k}", band="g", zeropoint=23.9)
        tables.append(odd.with_columns(flux_psf_err=np.array([value])))
        nothing = table([150.0], [2.0], obsid=f"not{k}", band="g", flux=np.nan if value <= 0 else value)
        tables.append(nothing)
    sources, _ = merge_brick(pix, tables, BANDS)
    assert len(sources) == 1
    for band in BANDS:
        flux, error = (np.array([v[part] for v in visits if v[2] == band]) for part in (0, 1))
        extra = 2 * len(unusable) if band == "g" else 0
        assert sources[f"n_{band}"][0] == len(flux) + extra  # detections, measured or not
        if len(flux) == 0:
            assert np.isnan(sources[f"flux_{band}"][0]) and np.isnan(sources[f"flux_err_{band}"][0])
            continue
        mean, sigma = (flux / error**2).sum() / (error**-2.0).sum(), (error**-2.0).sum() ** -0.5
        assert sources[f"flux_{band}"][0] == pytest.approx(mean, rel=1e-9, abs=1e-6 * sigma)
        assert sources[f"flux_err_{band}"][0] == pytest.approx(sigma, rel=1e-9)
        assert np.isnan(sources[f"mag_{band}"][0]) == (sources[f"flux_{band}"][0] <= 0)


def test_faint_fluxes_have_no_bias_and_the_quoted_error():
    """2000 sources of S/N 0.5 a visit, four visits: a third of the fluxes are negative. 5 sigma."""
    rng = stream(12, "faint")
    pix = int(healpix.brick_of(150.0, 2.0))
    ra, dec = 150.0 + (np.arange(2000) % 50) * 3 * ARCSEC, 2.0 + (np.arange(2000) // 50) * 3 * ARCSEC
    frames = [
        table(ra, dec, obsid=str(k), flux=25.0 + 50.0 * rng.normal(size=2000), zeropoint=23.9) for k in range(4)
    ]  # the error of `table` is 50
    flux = np.concatenate([merge_brick(p, frames, BANDS)[0]["flux_g"] for p in np.unique(healpix.brick_of(ra, dec))])
    assert len(flux) == 2000 and (flux < 0).mean() > 0.1 and pix in np.unique(healpix.brick_of(ra, dec))
    assert flux.mean() == pytest.approx(25.0, abs=5 * 25.0 / np.sqrt(2000))
    assert flux.std() == pytest.approx(25.0, rel=5 / np.sqrt(2 * 2000))


def test_star_votes_flags_and_counts():
    pix = int(healpix.brick_of(150.0, 2.0))
    one, two, three = (
        table([150.0], [2.0], obsid=str(k), band=band, snr=snr).with_columns(
            star=np.array([star]), flags=np.array([flags], np.int32)
        )
        for k, (band, snr, star, flags) in enumerate(
            [("g", 30.0, True, 1), ("g", 10.0, False, 4), ("y", -3.0, True, 1)]
        )
    )
    sources, _ = merge_brick(pix, [one, two, three], BANDS)
    assert sources["star"][0] == pytest.approx((30 + 1) / 41)  # the minimum vote is that of S/N 1
    assert sources["flags"][0] == 5 and sources["n_detections"][0] == 3
    assert (sources["n_g"][0], sources["n_y"][0], sources["n_u"][0]) == (2, 1, 0)


def test_two_sources_of_one_frame_are_not_merged():
    """A pair 0.2 arcsec apart, resolved in every frame, stays a pair, each with its own detections."""
    pair = sphere.unit_vectors(np.array([150.0, 150.0 + 0.2 * ARCSEC]), np.array([0.5, 0.5]))
    frames = visits(*sphere.ra_dec(pair), 5, count=3, scatter=0.01)
    sources, found = merge_brick(int(healpix.brick_of(150.0, 0.5)), frames, BANDS)
    assert len(sources) == 2 and (sources["n_detections"] == 3).all()
    assert (np.diff(found["number"].reshape(2, 3), axis=1) == 0).all()
    assert (sources["ra"].max() - sources["ra"].min()) / ARCSEC == pytest.approx(0.2, abs=0.03)


HOSTILE = {
    "ra": (np.nan, np.inf, -np.inf), "dec": (np.nan, np.inf, 90.1, -1e300),
    "pos_err": (np.nan, np.inf, 0.0, -0.01, 1e300),
}  # fmt: skip


@pytest.mark.parametrize(("column", "value"), [(name, value) for name, values in HOSTILE.items() for value in values])
def test_rows_without_a_position_or_its_error_are_counted_not_merged(column, value):
    good = table([150.0, 150.001], [2.0, 2.0])
    bad = table([150.0, 150.001], [2.0, 2.0], obsid="2")
    values = bad[column].copy()
    values[0] = value
    with np.errstate(all="raise"):
        sources, found = merge_brick(
            int(healpix.brick_of(150.0, 2.0)), [good, bad.with_columns(**{column: values})], BANDS
        )
    assert len(sources) == 2 and sorted(sources["n_detections"]) == [1, 2] and len(found) == 3
    fate = sources.meta["detections"]
    assert fate["no_error"] == (column == "pos_err") and fate["no_position"] == (column != "pos_err")
    assert fate["near"] == 3 + fate["no_error"] == fate["merged"] + fate["no_error"]
    assert all(np.isfinite(sources[name]).all() for name in ("ra", "dec", "pos_err", "star"))


@pytest.mark.parametrize("column", ["snr", "flux_psf", "flux_psf_err", "flux_kron", "flux_kron_err", "zeropoint"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, 1e-320, 1e308])
def test_a_hostile_number_stays_where_it_is(column, value):
    """It may cost its own row's flux or vote; position, counts and the other visits' fluxes stay."""
    good, bad = (table([150.0], [2.0], obsid=obsid) for obsid in "12")
    pix = int(healpix.brick_of(150.0, 2.0))
    sources, found = merge_brick(pix, [good, bad.with_columns(**{column: np.array([value])})], BANDS)
    assert len(sources) == 1 and len(found) == 2 and sources["n_g"][0] == 2
    assert 0.0 <= sources["star"][0] <= 1.0 and sources["ra"][0] == pytest.approx(150.0)
    if not np.isfinite(value):
        for name in ("flux_g", "kron_flux_g"):
            assert sources[name][0] == pytest.approx(merge_brick(pix, [good], BANDS)[0][name][0])


def test_total_fluxes_are_not_weighted_by_errors_that_grow_with_them():
    """Four visits with a tenth of their own flux as error: means with equal weights, and the error of four.

    Far above the noise, the mean of asinh magnitudes is that of magnitudes.
    """
    flux = [900.0, 1000.0, 1100.0, 1300.0]
    tables = [table([150.0], [2.0], obsid=str(k)) for k in range(4)]
    for one, light in zip(tables, flux, strict=True):
        for kind in ("total", "gaap"):
            one[f"flux_{kind}"][:], one[f"flux_{kind}_err"][:] = light, 0.1 * light
    sources, _ = merge_brick(int(healpix.brick_of(150.0, 2.0)), tables, BANDS)
    scale = 10 ** (0.4 * (23.9 - 30.0))
    assert sources["gaap_flux_g"][0] == pytest.approx(scale * np.mean(flux))
    assert sources["gaap_flux_err_g"][0] == pytest.approx(scale * 0.1 * np.sqrt(np.square(flux).sum()) / 4)
    assert sources["total_flux_g"][0] == pytest.approx(scale * np.exp(np.mean(np.log(flux))), rel=1e-3)
    assert sources["total_flux_err_g"][0] == pytest.approx(0.05 * sources["total_flux_g"][0], rel=1e-3)


def test_the_mean_of_skewed_fluxes_is_their_median():
    """ln of the flux is Gaussian, as at S/N 10; four visits of 5,000 sources, 4 sigma. Fluxes about 0: the mean."""
    rng = np.random.default_rng(81)
    source, noise = np.repeat(np.arange(5000), 4), np.full(20_000, 10.0)
    flux = 200.0 * np.exp(rng.normal(0.0, 0.3, 20_000))
    mean, error = _skewed_mean(source, flux, 0.3 * flux, noise, 5000)
    assert np.median(mean) == pytest.approx(200.0, rel=4 * 1.25 * 0.15 / np.sqrt(5000))
    assert error == pytest.approx(0.15 * mean, rel=0.05)
    flux = rng.normal(0.0, 10.0, 20_000)
    mean, error = _skewed_mean(source, flux, noise, noise, 5000)
    assert mean.mean() == pytest.approx(0.0, abs=4 * 5.0 / np.sqrt(5000))
    assert mean.std() == pytest.approx(error.mean(), rel=0.05) and error.mean() == pytest.approx(5.0, rel=0.1)


@pytest.mark.parametrize(("snr", "bias"), [(2.0, -0.045), (5.0, -0.015), (10.0, -0.004)])
def test_the_mean_of_symmetric_noise_is_faint_by_little(snr, bias):
    source, noise = np.repeat(np.arange(40_000), 4), np.full(160_000, 10.0)
    flux = np.random.default_rng(82).normal(10.0 * snr, 10.0, 160_000)
    mean = _skewed_mean(source, flux, noise, noise, 40_000)[0].mean() / (10.0 * snr)
    assert bias < mean - 1.0 < 0.0


@pytest.mark.parametrize("hostile", [0.0, -1.0, 1e-320, np.nan, np.inf])
def test_a_visit_without_a_usable_error_leaves_the_others(hostile):
    flux, noise = np.array([100.0, 100.0]), np.array([10.0, hostile])
    assert _skewed_mean(np.zeros(2, int), flux, np.full(2, 20.0), noise, 1) == (pytest.approx(100), pytest.approx(20))
    lost = np.array([100.0, hostile]) if not np.isfinite(hostile) else np.array([100.0, np.nan])
    found = _skewed_mean(np.zeros(2, int), lost, np.full(2, 20.0), np.full(2, 10.0), 1)
    assert found == (pytest.approx(100), pytest.approx(20))


@pytest.mark.parametrize("flux", [-50.0, 0.0, 3.0, 1e7])
def test_one_flux_is_its_own_mean_and_none_is_nan(flux):
    one = np.array([flux])
    mean, error = _skewed_mean(np.array([1]), one, np.array([7.0]), np.array([4.0]), 3)
    assert mean == pytest.approx([np.nan, flux, np.nan], nan_ok=True, rel=1e-9, abs=1e-9)
    assert error == pytest.approx([np.nan, 7.0, np.nan], nan_ok=True)


def test_every_detection_is_accounted_for():
    """One of each fate, by hand."""
    pix = int(healpix.brick_of(150.0, 2.0))
    ra, dec = healpix.brick_corners(pix)
    corner = float(ra[0]), float(dec[0])  # the northern one: what lies beyond belongs to others
    beyond = table([corner[0]], [corner[1] + ARCSEC], obsid="9")
    far = table([corner[0]], [corner[1] + 3 * ARCSEC], obsid="9")
    sharp = table([150.0], [2.0], obsid="2").with_columns(flags=np.array([64], np.int32))
    faint = table([150.001], [2.0], obsid="3", snr=4.0, flux=0.0)
    kept, lost = table([150.0], [2.0]), table([np.nan], [2.0], obsid="4")
    broken = table([150.0], [2.0], obsid="5", pos_err=np.nan)
    sources, found = merge_brick(pix, [kept, beyond, far, sharp, faint, lost, broken, kept, kept], BANDS)
    assert len(sources) == len(found) == 1 and sources.meta["left_out"] == 1
    assert sources.meta["detections"] == {
        "near": 7, "merged": 1, "repeated": 2, "sharp": 1, "no_error": 1, "elsewhere": 1, "left_out": 1,
        "no_position": 1,
    }  # fmt: skip


def test_rows_all_alike():
    """In frames of their own: one source; twins in each of two frames, at one position: two sources."""
    pix = int(healpix.brick_of(150.0, 2.0))
    many = [table([150.0], [2.0], obsid=str(k)) for k in range(50)]
    assert merge_brick(pix, many, BANDS)[0]["n_detections"].tolist() == [50]
    twins = [table([150.0, 150.0], [2.0, 2.0], obsid=str(k)) for k in range(2)]
    sources, _ = merge_brick(pix, twins, BANDS)
    assert sources["n_detections"].tolist() == [2, 2] and len(set(sources["source_id"])) == 2
    assert sources.meta["detections"]["repeated"] == 0
    alone, _ = merge_brick(pix, [table([150.0] * 300, [2.0] * 300)], BANDS)  # three hundred in one frame
    assert alone["n_detections"].tolist() == [1] * 300


def test_no_detection_gives_an_empty_table_with_every_column(tmp_path):
    full, _ = merge_brick(int(healpix.brick_of(150.0, 2.0)), [table([150.0], [2.0])], BANDS)
    for tables in ([], [table([], [])], [table([10.0], [-40.0])]):
        sources, found = merge_brick(int(healpix.brick_of(150.0, 2.0)), tables, BANDS)
        assert len(sources) == len(found) == 0 and list(sources) == list(full)
        assert {n: sources[n].dtype.kind for n in sources} == {n: full[n].dtype.kind for n in full}
        write_merged(tmp_path / "empty.parquet", sources, found, {})
        assert pq.read_table(tmp_path / "empty.parquet", partitioning=None).num_rows == 0


def test_the_file_links_sources_to_detections(tmp_path):
    rng = stream(9, "file")
    pix = int(healpix.brick_of(150.0, 2.0))
    ra, dec = healpy.pix2ang(256, pix, nest=True, lonlat=True)
    frames = visits(ra + rng.uniform(-0.05, 0.05, 40), dec + rng.uniform(-0.05, 0.05, 40), 10)
    sources, found = merge_brick(pix, frames, BANDS)
    write_merged(tmp_path / "a" / "Npix=1.parquet", sources, found, {"version": "x"})
    read = pq.read_table(tmp_path / "a" / "Npix=1.parquet", partitioning=None)
    assert read.column_names[0] == "_healpix_29" and (np.diff(read["_healpix_29"].to_numpy()) >= 0).all()
    keys = zip(*(found[name].tolist() for name in ("obsid", "chip", "number")), strict=True)
    by_key = dict(zip(keys, found["source"].tolist(), strict=True))
    for row, line in enumerate(read.to_pylist()):
        keys = list(zip(line["detection_obsid"], line["detection_chip"], line["detection_number"], strict=True))
        assert len(keys) == line["n_detections"] and {by_key[key] for key in keys} == {row}


def test_links_of_more_text_than_one_chunk_holds(tmp_path):
    """Twenty megabytes of obsid, as two million detections have."""
    sources, _ = merge_brick(int(healpix.brick_of(150.0, 2.0)), [table([150.0], [2.0])], BANDS)
    many = table(np.full(50_000, 150.0), np.full(50_000, 2.0), obsid="1" * 400)
    write_merged(tmp_path / "a.parquet", sources, many.with_columns(source=np.zeros(50_000, np.int64)), {})
    read = pq.read_table(tmp_path / "a.parquet", partitioning=None)
    assert len(read["detection_obsid"][0]) == 50_000 and read["detection_obsid"][0][-1].as_py() == "1" * 400


def test_noise_peaks_are_left_out_and_counted(tmp_path):
    """By hand: what each rule keeps. S/N of the frames -> kept."""
    cases = [((4.0,), False), ((5.1,), True), ((4.0, 4.0), False), ((4.6, 4.6), True), ((3.9, 3.9, 3.9), True)]
    pix = int(healpix.brick_of(150.0, 2.0))
    frames = []
    for visit in range(3):
        rows = [(150.0 + 3 * k * ARCSEC, snr[visit]) for k, (snr, _) in enumerate(cases) if len(snr) > visit]
        ra, snr = map(np.array, zip(*rows, strict=True))
        frame = table(ra, np.full(len(ra), 2.0), obsid=str(visit + 1), snr=snr, flux=50.0 * snr)
        frames.append(frame.with_columns(flags=np.zeros(len(ra), np.int32)))
    sources, found = merge_brick(pix, frames, BANDS)
    kept = np.rint((np.sort(sources["ra"]) - 150.0) / ARCSEC / 3).astype(int).tolist()
    assert kept == [k for k, (_, keep) in enumerate(cases) if keep] and sources.meta["left_out"] == 2
    assert len(found) == 1 + 2 + 3
    write_merged(tmp_path / "a.parquet", sources, found, {"brick": pix})
    assert ObjectTable.read(tmp_path / "a.parquet").meta["left_out"] == 2


@pytest.mark.parametrize(("apart", "kept"), [(0.0, True), (2.0, True), (3.5, False)])
def test_noise_peaks_around_a_position_do_not_speak_for_it(apart, kept):
    """Three detections at the corners of a triangle, `apart` errors from its middle: all agree with one another."""
    pix, error = int(healpix.brick_of(150.0, 0.0)), 0.05
    corners = apart * np.hypot(error, FLOOR) * np.exp(2j * np.pi * np.arange(3) / 3)
    tables = [
        table([150.0 + c.real * ARCSEC], [c.imag * ARCSEC], obsid=str(k), snr=4.0, flux=200.0).with_columns(
            pos_err=np.array([error]), flags=np.zeros(1, np.int32)
        )
        for k, c in enumerate(corners)
    ]
    sources, _ = merge_brick(pix, tables, BANDS)
    assert len(sources) == kept and sources.meta["left_out"] == (not kept)


def test_a_kron_flux_alone_is_no_source_unless_the_psf_sees_it():
    pix = int(healpix.brick_of(150.0, 2.0))
    dim = table([150.0], [2.0], snr=1.0, flux=3000.0)  # Kron S/N 47: a neighbour's light
    seen = table([150.0], [2.0], snr=3.0, flux=3000.0)
    assert len(merge_brick(pix, [dim], BANDS)[0]) == 0 and len(merge_brick(pix, [seen], BANDS)[0]) == 1
    for flag in (32, 64, 128):  # not centred, sharp, bad pixels: none of them stands alone
        doubtful = seen.with_columns(flags=np.array([flag], np.int32))
        assert len(merge_brick(pix, [doubtful], BANDS)[0]) == 0
    sources, found = merge_brick(pix, [seen, doubtful.with_columns(obsid=np.array(["2"]))], BANDS)
    assert len(sources) == 1 and len(found) == 2  # next to a good one it counts


@pytest.mark.parametrize(
    ("snr", "flags", "kept"), [(19.0, 128, 0), (21.0, 128, 1), (21.0, 128 | 32, 0), (21.0, 128 | 256, 0)]
)
def test_a_bright_source_is_not_lost_to_a_ray_next_to_it(snr, flags, kept):
    """Of one exposure: what a ray leaves of itself is fainter, not centred, or has no shape."""
    one = table([150.0], [2.0], snr=snr).with_columns(flags=np.array([flags], np.int32))
    assert len(merge_brick(int(healpix.brick_of(150.0, 2.0)), [one], BANDS)[0]) == kept


@pytest.mark.parametrize(("frames", "credible"), [(1, 0), (2, 0), (3, 1), (4, 1)])
def test_faint_sources_stand_from_the_third_visit_on(frames, credible):
    """S/N 3 each: two of them are not S/N 6.3 together, and three agree by chance a few times a brick."""
    pix = int(healpix.brick_of(150.0, 2.0))
    tables = [table([150.0], [2.0], obsid=str(k), snr=3.0, flux=150.0) for k in range(frames)]
    for one in tables:
        one["flux_kron"][:], one["flux_kron_err"][:] = 100.0, 60.0
    sources, _ = merge_brick(pix, tables, BANDS)
    assert len(sources) == credible and sources.meta["left_out"] == 1 - credible


def test_positions_are_weighted_by_their_errors():
    """Two visits, 10 and 20 mas: the mean lies four times nearer to the better one, with the error of both."""
    pix = int(healpix.brick_of(150.0, 2.0))
    moved = 0.05 * ARCSEC
    one = table([150.0], [2.0], obsid="1", pos_err=0.01)
    two = table([150.0], [2.0 + moved], obsid="2", pos_err=0.02)
    sources, _ = merge_brick(pix, [one, two], BANDS)
    assert (sources["dec"][0] - 2.0) / moved == pytest.approx(0.2, abs=1e-3)
    assert sources["pos_err"][0] == pytest.approx((0.01**-2 + 0.02**-2) ** -0.5, rel=1e-6)


def test_every_kind_of_flux_is_its_own_mean_in_its_own_band():
    """Two visits in r, one in i, in microjansky: each flux by its own errors, of profiles by those of the PSF's."""
    pix = int(healpix.brick_of(150.0, 2.0))
    kinds = {"psf": ("", 100.0, 4.0), "kron": ("kron_", 200.0, 8.0), "total": ("total_", 400.0, 30.0),
             "gaap": ("gaap_", 800.0, 50.0)}  # fmt: skip
    tables = [table([150.0], [2.0], obsid=str(k), band=band, zeropoint=23.9) for k, band in enumerate("RRi")]
    for k, one in enumerate(tables):
        for n, (kind, (_, flux, error)) in enumerate(kinds.items()):
            one[f"flux_{kind}"][:] = flux + 10 * (n + 1) * k
            one[f"flux_{kind}_err"][:] = error * (1 + (k == 1) * (n + 1))
    sources, _ = merge_brick(pix, tables, BANDS)
    for n, (prefix, flux, error) in enumerate(kinds.values()):
        noise = np.array([4.0, 8.0]) if n > 1 else error * np.array([1.0, n + 2])
        weight, errors = noise**-2.0 / (noise**-2.0).sum(), error * np.array([1.0, n + 2])
        fluxes = np.array([flux, flux + 10 * (n + 1)])
        mean, sigma = weight @ fluxes, np.sqrt(((weight * errors) ** 2).sum())
        if prefix == "total_":
            soft = 2 * (noise**-2.0).mean() ** -0.5
            asinh = np.log(fluxes / soft + np.sqrt((fluxes / soft) ** 2 + 1))
            mean = 0.5 * soft * (np.exp(weight @ asinh) - np.exp(-weight @ asinh))
            sigma = np.hypot(mean, soft) * np.sqrt(((weight * errors / np.hypot(fluxes, soft)) ** 2).sum())
        found = [sources[f"{prefix}{name}"][0] for name in ("flux_r", "flux_err_r", "mag_r", "mag_err_r")]
        assert found == pytest.approx([mean, sigma, 23.9 - 2.5 * np.log10(mean), 2.5 / np.log(10) * sigma / mean])
        assert sources[f"{prefix}flux_i"][0] == pytest.approx(flux + 20 * (n + 1))
        assert sources[f"{prefix}flux_err_i"][0] == pytest.approx(error)
    assert (sources["n_r"][0], sources["n_i"][0], sources["n_g"][0]) == (2, 1, 0)


def test_epochs_are_weighted_as_positions_are_and_unknown_ones_are_nan():
    pix = int(healpix.brick_of(150.0, 2.0))
    visits = [table([150.0, 150.001], [2.0, 2.0], obsid=str(k), pos_err=error) for k, error in enumerate((0.01, 0.02))]
    times = [
        one.with_columns(mjd=np.full(2, 61000.0 + 8 * k), exptime=np.full(2, 150.0)) for k, one in enumerate(visits)
    ]
    sources, found = merge_brick(pix, times, BANDS)
    weight = 1 / (0.01**2 + FLOOR**2), 1 / (0.02**2 + FLOOR**2)
    assert sources["epoch"] == pytest.approx(np.full(2, 61000.0 + 8 * weight[1] / sum(weight)), abs=1e-6)
    assert not sources["pmra"].any() and not sources["pmdec"].any() and not sources["motion"].any()
    assert sources["source_id"].tolist() == [pix * 2**20, pix * 2**20 + 1]
    assert found["source"].tolist() == [0, 0, 1, 1] and sorted(found["obsid"][:2]) == ["0", "1"]
    assert np.isnan(merge_brick(pix, visits, BANDS)[0]["epoch"]).all()
