"""Merging: order, ownership at borders, corners, RA 0 and a pole, photometry of repeated visits."""

import healpy
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from csstsim.bricks import healpix
from csstsim.bricks.merge import DETECTION_COLUMNS, merge_brick, write_merged
from csstsim.catalog.table import ObjectTable
from csstsim.rng import stream

ARCSEC = 1.0 / 3600.0


def table(ra, dec, *, obsid="1", chip=8, band="g", flux=1000.0, snr=20.0, pos_err=0.01, zeropoint=30.0):
    n = len(ra)
    columns = {
        "obsid": np.full(n, obsid), "chip": np.full(n, chip, np.int16), "filter": np.full(n, band),
        "number": np.arange(n, dtype=np.int32), "ra": np.asarray(ra, float), "dec": np.asarray(dec, float),
        "pos_err": np.full(n, pos_err), "flux_psf": np.broadcast_to(flux, n).astype(float),
        "flux_psf_err": np.full(n, 50.0), "flux_kron": np.broadcast_to(flux, n) * 0.95,
        "flux_kron_err": np.full(n, 60.0), "zeropoint": np.full(n, zeropoint),
        "snr": np.broadcast_to(snr, n).astype(float),
        "star": np.ones(n, bool), "flags": np.full(n, 1 if obsid == "1" else 2, np.int32),
    }  # fmt: skip
    return ObjectTable({name: columns[name] for name in DETECTION_COLUMNS})


def visits(ra, dec, seed, count=4, scatter=0.02):
    """`count` frames of the same sources, each shifted by `scatter` arcsec (rms per axis)."""
    rng = stream(seed, "visits")
    v = healpix.to_vectors(ra, dec)
    frames = []
    for k in range(count):
        moved = v + np.radians(scatter * ARCSEC) * rng.normal(size=v.shape)
        band = "ugri"[k % 4]
        snr = rng.uniform(5, 50, len(ra))
        frames.append(table(*healpix.from_vectors(moved), obsid=str(k + 1), chip=8 + k, band=band, snr=snr))
    return frames


def places():
    """Around (RA, Dec) where bricks meet or coordinates wrap: a corner of four, RA 0, both poles, mid-brick."""
    ra, dec = healpix.brick_corners(123456)
    return [(ra[0], dec[0]), (0.0, 0.0), (0.0, 20.123), (45.0, 90.0), (10.0, -90.0), (200.3, -35.2)]


@pytest.mark.parametrize("place", places())
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_every_source_is_in_one_brick_and_nothing_depends_on_order(place, seed):
    rng = stream(seed, "sky")
    # 30 sources on a jittered lattice, 1.5 arcsec apart, over the meeting point
    lattice = np.stack(np.meshgrid(np.arange(6) - 2.5, np.arange(5) - 2.0), axis=-1).reshape(-1, 2) * 1.5
    lattice += rng.uniform(-0.3, 0.3, lattice.shape)
    centre = healpix.to_vectors(*place)
    east = np.cross([0, 0, 1.0], centre) if abs(place[1]) < 89 else np.array([1.0, 0, 0])
    east /= np.linalg.norm(east)
    sky = centre + np.radians(lattice * ARCSEC) @ np.stack([east, np.cross(centre, east)])
    frames = visits(*healpix.from_vectors(sky), seed)
    everything = np.concatenate([healpix.brick_of(frame["ra"], frame["dec"]) for frame in frames])
    bricks = np.unique(everything)
    merged = {pix: merge_brick(pix, frames) for pix in bricks}
    assert sum(len(sources) for sources, _ in merged.values()) == 30
    assert sum(len(found) for _, found in merged.values()) == 120
    shuffled = [frame.take(rng.permutation(len(frame))) for frame in frames]
    shuffled = [shuffled[k] for k in rng.permutation(len(frames))]
    for pix, (sources, found) in merged.items():
        assert (healpix.brick_of(sources["ra"], sources["dec"]) == pix).all()
        assert (sources["n_detections"] == 4).all()
        again = merge_brick(pix, shuffled)
        assert again[0] == sources and again[1] == found  # bit by bit
    positions = np.concatenate([healpix.to_vectors(s["ra"], s["dec"]) for s, _ in merged.values()])
    unit = sky / np.linalg.norm(sky, axis=1, keepdims=True)
    nearest = np.linalg.norm(positions[:, None] - unit[None], axis=2).min(axis=1)
    assert np.degrees(nearest).max() / ARCSEC < 0.06  # arcsec: 4 visits of 0.02 per axis, 6 sigma


def test_photometry_of_two_visits_is_the_weighted_mean():
    ra, dec = [150.0], [2.0]
    pix = int(healpix.brick_of(150.0, 2.0))
    one = table(ra, dec, obsid="1", flux=1000.0, zeropoint=30.0)
    two = table(ra, dec, obsid="2", flux=4400.0, zeropoint=31.5)  # 3.981 times as deep
    nuv = table(ra, dec, obsid="3", band="NUV", flux=-20.0)
    sources, found = merge_brick(pix, [one, two, nuv])
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


def test_two_sources_of_one_frame_are_not_merged():
    """A pair 0.2 arcsec apart, resolved in every frame, stays a pair, each with its own detections."""
    pair = healpix.to_vectors(np.array([150.0, 150.0 + 0.2 * ARCSEC]), np.array([0.5, 0.5]))
    frames = visits(*healpix.from_vectors(pair), 5, count=3, scatter=0.01)
    sources, found = merge_brick(int(healpix.brick_of(150.0, 0.5)), frames)
    assert len(sources) == 2 and (sources["n_detections"] == 3).all()
    assert (np.diff(found["number"].reshape(2, 3), axis=1) == 0).all()
    assert (sources["ra"].max() - sources["ra"].min()) / ARCSEC == pytest.approx(0.2, abs=0.03)


def test_no_detection_gives_an_empty_table_with_every_column(tmp_path):
    full, _ = merge_brick(int(healpix.brick_of(150.0, 2.0)), [table([150.0], [2.0])])
    for tables in ([], [table([], [])], [table([10.0], [-40.0])]):
        sources, found = merge_brick(int(healpix.brick_of(150.0, 2.0)), tables)
        assert len(sources) == len(found) == 0 and list(sources) == list(full)
        assert {n: sources[n].dtype.kind for n in sources} == {n: full[n].dtype.kind for n in full}
        write_merged(tmp_path / "empty.parquet", sources, found, {})
        assert pq.read_table(tmp_path / "empty.parquet", partitioning=None).num_rows == 0


def test_the_file_links_sources_to_detections(tmp_path):
    rng = stream(9, "file")
    pix = int(healpix.brick_of(150.0, 2.0))
    ra, dec = healpy.pix2ang(256, pix, nest=True, lonlat=True)
    frames = visits(ra + rng.uniform(-0.05, 0.05, 40), dec + rng.uniform(-0.05, 0.05, 40), 10)
    sources, found = merge_brick(pix, frames)
    write_merged(tmp_path / "a" / "Npix=1.parquet", sources, found, {"version": "x"})
    read = pq.read_table(tmp_path / "a" / "Npix=1.parquet", partitioning=None)
    assert read.column_names[0] == "_healpix_29" and (np.diff(read["_healpix_29"].to_numpy()) >= 0).all()
    keys = zip(*(found[name].tolist() for name in ("obsid", "chip", "number")), strict=True)
    by_key = dict(zip(keys, found["source"].tolist(), strict=True))
    for row, line in enumerate(read.to_pylist()):
        keys = list(zip(line["detection_obsid"], line["detection_chip"], line["detection_number"], strict=True))
        assert len(keys) == line["n_detections"] and {by_key[key] for key in keys} == {row}


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
    sources, found = merge_brick(pix, frames)
    kept = np.rint((np.sort(sources["ra"]) - 150.0) / ARCSEC / 3).astype(int).tolist()
    assert kept == [k for k, (_, keep) in enumerate(cases) if keep] and sources.meta["left_out"] == 2
    assert len(found) == 1 + 2 + 3
    write_merged(tmp_path / "a.parquet", sources, found, {"brick": pix})
    assert ObjectTable.read(tmp_path / "a.parquet").meta["left_out"] == 2


def test_a_kron_flux_alone_is_no_source_unless_the_psf_sees_it():
    pix = int(healpix.brick_of(150.0, 2.0))
    dim = table([150.0], [2.0], snr=1.0, flux=3000.0)  # Kron S/N 47: a neighbour's light
    seen = table([150.0], [2.0], snr=3.0, flux=3000.0)
    assert len(merge_brick(pix, [dim])[0]) == 0 and len(merge_brick(pix, [seen])[0]) == 1
    for flag in (32, 64, 128):  # not centred, sharp, bad pixels: none of them stands alone
        doubtful = seen.with_columns(flags=np.array([flag], np.int32))
        assert len(merge_brick(pix, [doubtful])[0]) == 0
    sources, found = merge_brick(pix, [seen, doubtful.with_columns(obsid=np.array(["2"]))])
    assert len(sources) == 1 and len(found) == 2  # beside a good one it counts
