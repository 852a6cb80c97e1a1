"""The PSF file: written and read back, interpolation weights, and every way a file can be unusable."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import PsfConfig
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.focal_plane import load_focal_plane, samples
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.diffraction import Diffraction, blur
from csstsim.optics.psf.interpolation import METHODS, Interpolator
from csstsim.optics.psf.psf_file import PsfSet, half_pixels, larger_cells, pixel_response
from csstsim.optics.psf.psf_set import PsfSampling, make_psf, node_psf
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.stages.psf import open_psf

GRID, CELLS = 3, 32


@pytest.fixture(scope="module")
def made(camera, tmp_path_factory):
    """A 3 x 3 set of chip 8 (g), four cells to a pixel."""
    path = tmp_path_factory.mktemp("psf") / "chip_08.h5"
    chip = camera.chips[8]
    options = {"camera_digest": camera.digest_for("psf"), "provenance": {"seed": 7}}
    uv = samples(load_focal_plane(SHIPPED / "instrument" / "distortion.yaml"), chip, GRID)[:, :2]
    sampling = PsfSampling(GRID, cells=CELLS, nodes_uv=uv)
    make_psf(path, chip, camera.filters[chip.filter], camera.psf, sampling, **options)
    return path


@pytest.fixture
def copy(made, tmp_path):
    return shutil.copy(made, tmp_path / "copy.h5")


def test_nodes_say_where_on_the_sky_their_light_comes_from(made, camera, make_pointing):
    """u, v at position angle 0, read by the distorted WCS, is the node's pixel."""
    psf, pointing = PsfSet(made), replace(make_pointing(), ra=10.0, dec=0.0, pa=0.0)
    field = load_distortion(SHIPPED / "instrument" / "distortion.fits")
    wcs = ChipWCS(camera.chips[8], pointing, field)
    xi, eta = np.radians(psf.nodes_uv.T)  # on the tangent plane of a boresight on the equator
    ra, dec = 10.0 + np.degrees(np.arctan(xi)), np.degrees(np.arctan(eta * np.cos(np.arctan(xi))))
    np.testing.assert_allclose(np.transpose(wcs.world_to_pixel(ra, dec)), psf.nodes_xy, atol=1e-3)


def test_file_says_what_it_holds(made, camera):
    psf = PsfSet(made, chip=8, filter="g", grid=GRID, camera_digest=camera.digest_for("psf"))
    assert psf.image.shape == (9, 4, CELLS, CELLS)
    assert isinstance(psf.image, np.memmap)
    assert psf.scale == pytest.approx(0.0185)
    assert psf.oversampling == 4
    about = {"sample": "cell_integral", "cell_um": 2.5, "chip": 8, "filter": "g", "grid": 3, "format": 2}
    assert about.items() <= psf.attributes.items()
    assert json.loads(psf.attributes["provenance"]) == {"seed": 7}
    assert psf.wavelength == pytest.approx(camera.filters["g"].psf_wavelength)
    assert not list(made.parent.glob(".*")), "no temporary file stays behind"
    # The outer nodes lie on the outer edges of the outer pixels
    assert psf.nodes_xy[[0, 2, 6]].tolist() == [[-0.5, -0.5], [9215.5, -0.5], [-0.5, 9231.5]]


def test_stored_node_is_the_optics_at_its_place(made, camera):
    psf, chip = PsfSet(made), camera.chips[8]
    wavefront = load_wavefront(camera.psf)
    optics = [Diffraction(w, 2.0, 0.0185, wavefront, CELLS) for w in psf.wavelength]
    # node 5 is at the right edge, half way up
    coefficients = chip_coefficients(wavefront, camera.psf, chip, 9215.5, 4615.5)
    images, tilt = node_psf(optics, coefficients, blur(camera.psf, 0.0185, 2.5), 4)
    assert psf.node(5) == pytest.approx(images, abs=1e-7)
    assert psf.tilt[5] == pytest.approx(tilt, abs=1e-6)  # px
    assert psf.flux[5] == pytest.approx(images.sum(axis=(1, 2)), rel=1e-6)
    assert ((psf.flux > 0.93) & (psf.flux < 1)).all()  # in a box of 8 px
    assert psf.image.min() >= 0


def test_same_call_gives_the_same_bits(made, camera, tmp_path):
    chip, again = camera.chips[8], tmp_path / "again.h5"
    sampling, digest = PsfSampling(GRID, cells=CELLS), camera.digest_for("psf")
    make_psf(again, chip, camera.filters["g"], camera.psf, sampling, camera_digest=digest)
    assert np.array_equal(PsfSet(made).image, PsfSet(again).image)


def test_grating_chip_turns_about_its_centre(camera, tmp_path):
    chip = replace(camera.chips[1], rotation=90.0)
    still = {"detector": {"height": 0.0, "tilt": 0.0}, "filter_figure": {"rms": {chip.filter: 0.0}, "noll": [5]}}
    own = camera.psf | still  # what turns with the chip
    made = []
    for turned in (chip, replace(chip, rotation=0.0, detector=replace(chip.detector, nx=9232, ny=9216))):
        path = tmp_path / f"{turned.rotation}.h5"
        make_psf(path, turned, camera.filters[chip.filter], own, PsfSampling(2, cells=16), camera_digest="x")
        made.append(PsfSet(path).image)
    # A quarter turn takes the chip's lower right corner (node 1) to the mosaic's upper right (node 3 unturned)
    assert made[0][1] == pytest.approx(made[1][3], abs=1e-6)


def test_at_a_node_it_is_the_node(made):
    for method in METHODS:
        psf = PsfSet(made, method=method)
        for i, (x, y) in enumerate(psf.nodes_xy):
            assert np.array_equal(psf.at(x, y), psf.node(i).astype(float))


def test_between_nodes_it_is_the_weighted_sum(made):
    x, y = 3000.2, 7000.7
    for method, k in (("idw", 5), ("bilinear", 4), ("bicubic", 9)):
        psf = PsfSet(made, method=method, beta=1.5, neighbours=5)
        mixture = Interpolator(psf.nodes_xy, method, beta=1.5, neighbours=5)
        index, weight, outside = psf.weights(x, y)
        for got, expected in zip((index, weight, outside), mixture(x, y), strict=True):
            assert np.array_equal(got, expected)
        assert (index.shape, bool(outside), psf.convex) == ((k,), False, method != "bicubic")
        expected = np.tensordot(weight, psf.image[index].astype(float), axes=1)
        assert psf.at(x, y) == pytest.approx(expected, abs=1e-12)
    assert pixel_response(psf.at(x, y), 4).shape == (4, CELLS - 3, CELLS - 3)
    assert psf.weights(np.full((2, 3), x), y)[0].shape == (2, 3, 9)
    with pytest.raises(ValueError, match="not finite"):
        psf.weights(np.nan, 1.0)


def test_the_campaign_chooses_the_interpolation(made, camera):
    for given, k, convex in [
        ({}, 4, True),
        ({"interpolation": "bicubic"}, 9, False),
        ({"interpolation": "idw", "neighbours": 3}, 3, True),
    ]:
        config = SimpleNamespace(psf=PsfConfig(grid=GRID, **given))
        run = SimpleNamespace(config=config, camera=camera, paths=SimpleNamespace(psf=lambda chip: made))
        psf = open_psf(run, camera.chips[8])
        assert (psf.weights(5.0, 5.0)[0].size, psf.convex) == (k, convex)


def test_convex_mixtures_stay_between_their_nodes(made):
    for method in ("idw", "bilinear"):
        psf = PsfSet(made, method=method)
        index, _, _ = psf.weights(1000.0, 2000.0)
        lowest, highest = psf.image[index].min(axis=0), psf.image[index].max(axis=0)
        assert ((psf.at(1000.0, 2000.0) >= lowest - 1e-9) & (psf.at(1000.0, 2000.0) <= highest + 1e-9)).all()


def test_dead_node_is_never_used(copy):
    with h5py.File(copy, "r+") as file:
        file["image"][4, 2, 3, 3] = np.nan
        file["flux"][4, 2] = np.nan
    for method in METHODS:
        psf = PsfSet(copy, method=method, neighbours=9)
        assert psf.dead.nonzero()[0].tolist() == [4]
        index, weight, outside = psf.weights(*psf.nodes_xy[4])
        assert 4 not in index and not outside
        assert weight.sum() == pytest.approx(1.0)
        assert np.isfinite(psf.at(*psf.nodes_xy[4])).all()


def test_damaged_node_is_an_error_when_it_is_used(copy):
    with h5py.File(copy, "r+") as file:
        file["image"][4, 2, 3, 3] = np.nan
        file["image"][5, 0, 16, 16] *= 1.001
    psf = PsfSet(copy)
    psf.node(3)
    for i in (4, 5):
        with pytest.raises(InputError, match=rf"copy\.h5: image\[{i}\]: does not sum to its flux"):
            psf.at(*psf.nodes_xy[i])


@pytest.mark.parametrize("fraction", [0.0, 0.001, 0.3, 0.999])
def test_truncated_file(copy, fraction):
    size = copy.stat().st_size
    with copy.open("r+b") as file:
        file.truncate(int(fraction * size))
    with pytest.raises(InputError, match=r"copy\.h5"):
        PsfSet(copy)


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("chip", 9, "8.*allowed: 9"),
        ("filter", "r", "'g'.*allowed: r"),
        ("grid", 30, "3.*30"),
        ("oversampling", 2, "4.*2"),
        ("camera_digest", "ab", "ab"),
    ],
)
def test_file_of_another_chip_or_camera(made, key, value, allowed):
    with pytest.raises(InputError, match=rf"chip_08\.h5: {key}: made for another campaign; remove it .*{allowed}"):
        PsfSet(made, **{key: value})


def test_missing_and_foreign_files(tmp_path, copy):
    with pytest.raises(InputError, match=r"none\.h5: cannot read the PSF file: No such file"):
        PsfSet(tmp_path / "none.h5")
    with pytest.raises(InputError, match="cannot read the PSF file"):
        PsfSet(tmp_path)
    with h5py.File(copy, "r+") as file:
        del file["tilt"]
    with pytest.raises(InputError, match="tilt: not a PSF file"):
        PsfSet(copy)


def test_wrong_content(copy):
    def change(name, data):
        with h5py.File(copy, "r+") as file:
            del file[name]
            file[name] = data

    with h5py.File(copy, "r") as file:
        good = {name: file[name][()] for name in file}
    for name, data, message in [
        ("nodes_xy", good["nodes_xy"][:8], "nodes_xy: wrong shape"),
        ("nodes_xy", np.full((9, 2), np.inf), "nodes_xy: holds a value that is not finite"),
        ("wavelength", good["wavelength"][:3], "wavelength: wrong shape"),
        ("image", good["image"][..., 1:], "image: wrong shape"),
        ("image", good["image"].astype(float), "image: must be contiguous float32"),
        ("flux", good["flux"] * np.nan, "flux: fewer than three nodes are alive"),
    ]:
        change(name, data)
        with pytest.raises(InputError, match=message):
            PsfSet(copy)
        change(name, good[name])
    PsfSet(copy)
    change("nodes_xy", np.stack([np.arange(9.0), np.arange(9.0)], axis=1))
    with pytest.raises(InputError, match=r"copy\.h5: nodes_xy: the nodes form no grid of rows and columns"):
        PsfSet(copy)
    assert PsfSet(copy, method="idw").weights([4.0, 4.0], [4.0, 5.0])[2].tolist() == [False, True]


@pytest.mark.parametrize(
    ("name", "value"),
    [("grid", "three"), ("cell_arcsec", "wide"), ("grid", [3, 3]), ("chip", [8, 8]), ("cell_arcsec", [])],
)
def test_nonsense_in_the_metadata(copy, name, value):
    with h5py.File(copy, "r+") as file:
        file.attrs[name] = value
    with pytest.raises(InputError, match=r"copy\.h5"):
        PsfSet(copy, chip=8)


def test_every_byte_outside_the_images_is_guarded(copy):
    """One bit turned at a time: refused in one line, or of no consequence; never a traceback or another number."""
    content, good = bytearray(copy.read_bytes()), PsfSet(copy)
    with h5py.File(copy, "r") as file:
        start = file["image"].id.get_offset()
    end = start + good.image.nbytes
    positions = [i for i in range(len(content)) if not start <= i < end]
    refused, tried = 0, positions[::17]
    for position in tried:
        damaged = bytearray(content)
        damaged[position] ^= 0x10
        copy.write_bytes(damaged)
        try:
            psf = PsfSet(copy)
        except InputError as error:
            assert "copy.h5" in str(error)
            refused += 1
            continue
        assert psf.attributes == good.attributes
        for name in ("nodes_xy", "wavelength", "tilt", "flux", "image"):
            assert np.array_equal(getattr(psf, name), getattr(good, name)), (position, name)
    assert refused > 0.3 * len(tried)  # the rest is unused space


def test_point_samples_are_not_read_as_cell_integrals(copy):
    with h5py.File(copy, "r+") as file:
        file.attrs["sample"] = "point"
    with pytest.raises(
        InputError, match=r"sample: made for another campaign; remove it .*'point'.*allowed: cell_integral"
    ):
        PsfSet(copy)


def test_failure_leaves_no_file(camera, tmp_path):
    too_blurred = {**camera.psf, "design": [[4, np.inf, 0, 0, 0, 0, 0]]}
    for params, grid in ((too_blurred, 2), (camera.psf, 1)):
        with pytest.raises(InputError):
            make_psf(
                tmp_path / "x.h5",
                camera.chips[8],
                camera.filters["g"],
                params,
                PsfSampling(grid),
                camera_digest="",
            )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("method", METHODS)
def test_a_linear_function_of_nodes_is_that_of_the_mixture(made, method):
    psf, asked = PsfSet(made, method=method), []

    def means(images):
        asked.append(1)
        return images.mean(axis=0, dtype=float)[::3]

    at = psf.mixed(means)
    for position in ((4000.0, 7000.0), (100.0, 30.0), (4000.0, 7000.0)):
        np.testing.assert_allclose(at(*position), psf.at(*position).mean(axis=0)[::3], rtol=0, atol=1e-15)
    assert len(asked) <= GRID**2  # once a node


def test_three_live_nodes_are_enough_and_two_are_not(copy):
    with h5py.File(copy, "r+") as file:
        flux = file["flux"][()]
        flux[3:, 1] = np.nan
        file["flux"][...] = flux
    assert PsfSet(copy, method="idw").dead.tolist() == [False] * 3 + [True] * 6
    with h5py.File(copy, "r+") as file:
        flux[2, 0] = np.nan
        file["flux"][...] = flux
    with pytest.raises(InputError, match="fewer than three nodes are alive"):
        PsfSet(copy, method="idw")


def test_larger_cells_are_sums_about_the_middle():
    """8 x 8 numbers that all differ: what fills no whole cell on both sides is left out."""
    image = np.arange(2 * 64.0).reshape(2, 8, 8) ** 1.5
    found = larger_cells(image, 4, 2)
    assert found.shape == (2, 4, 4) and found[1, 0, 3] == pytest.approx(image[1, :2, 6:].sum())
    odd = image[:, :6, :6]
    found = larger_cells(odd, 4, 2)  # one cell left over on each side
    assert found.shape == (2, 2, 2)
    assert found[0] == pytest.approx(odd[0, 1:5, 1:5].reshape(2, 2, 2, 2).sum(axis=(1, 3)))
    assert np.array_equal(larger_cells(image, 4, 4), image) and np.array_equal(half_pixels(odd, 4), found)
