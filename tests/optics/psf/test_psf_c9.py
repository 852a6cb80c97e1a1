"""An external library: files in Cycle 9's layout are read back as the PSFs they were made from."""

import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from support.mini_campaign import write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.optics.psf.chip_errors import chip_coefficients, mosaic_position
from csstsim.optics.psf.psf_c9 import _numbered, _row_by_row, _wavelengths, check_library, convert
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.optics.psf.psf_set import PsfSampling, chip_optics, make_psf, node_psf
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.stages import psf as psf_stage


@pytest.fixture(scope="module")
def chip(camera):
    """One with two cells to a pixel, as in the library."""
    return next(c for c in camera.chips.values() if c.filter == "z")


@pytest.fixture(scope="module")
def own(camera, chip, tmp_path_factory):
    """Our own 2 x 2 set."""
    path = tmp_path_factory.mktemp("own") / "own.h5"
    make_psf(path, chip, camera.filters["z"], camera.psf, PsfSampling(2), camera_digest=camera.digest)
    return PsfSet(path)


def write_library(folder, chip, images, nodes, *, mm=True, wavelength=None, first=0, order=None):
    """Write images (n, 4, cells, cells) at chip pixels (n, 2) in the layout of the library."""
    positions = np.stack(mosaic_position(chip, *nodes.T), axis=-1) / 100.0 if mm else nodes  # 10 um pixels
    with h5py.File(folder / f"psfCube_{chip.id}.h5", "w") as file:
        for i in range(4):
            for j, k in enumerate(order if order is not None else range(len(images))):
                group = file.create_group(f"w_{i}/psf_{j + first}")
                group["psfMat"] = images[k, i].astype(np.float64)
                group["image_x" if mm else "x"], group["image_y" if mm else "y"] = positions[k]
            if wavelength is not None:
                file[f"w_{i}"].attrs["wavelength"] = wavelength[i]


def read(folder, chip, camera, sample="cell_integral"):
    convert(folder, folder / "psf.h5", chip, camera.filters["z"], sample=sample, camera_digest="d")
    return PsfSet(folder / "psf.h5", chip=chip.id, filter="z", camera_digest="d")


@pytest.mark.parametrize("options", [{}, {"mm": False, "first": 1, "order": [2, 3, 1, 0]}])
def test_cell_integrals_come_back_as_they_were(own, chip, camera, tmp_path, options):
    write_library(tmp_path, chip, np.array(own.image), own.nodes_xy, **options)
    psf = read(tmp_path, chip, camera)
    assert psf.oversampling == 2
    assert psf.attributes["grid"] == 2
    assert psf.nodes_xy == pytest.approx(own.nodes_xy, abs=1e-6)  # in our order again
    expected = own.image / own.image.sum(axis=(2, 3), keepdims=True)
    assert np.abs(psf.image - expected).max() < 1e-4 * expected.max()  # of centring
    assert psf.tilt == pytest.approx(0.0, abs=1e-4)  # px: it was centred
    assert psf.flux == pytest.approx(1.0, abs=1e-6)
    about = json.loads(psf.attributes["provenance"])
    assert about["library"] == f"psfCube_{chip.id}.h5"
    assert about["read_as"].startswith("cell_integral; places: ")
    assert "the filter's" in about["read_as"]
    assert len(about["library_sha256"]) == 64


def test_point_samples_become_cell_integrals_and_are_centred(own, chip, camera, tmp_path):
    """Brightness at the cells' middles from the optics themselves, off centre, against integrals from the optics."""
    wavefront = load_wavefront(camera.psf)
    optics, integral = chip_optics(chip, camera.filters["z"], camera.psf, wavefront, 2)

    def point(f):
        return integral(f) / np.sinc(f)

    rows = chip_coefficients(wavefront, camera.psf, chip, *own.nodes_xy.T)
    points, moved = [], np.array([0.31, -0.2])  # cells
    for row in rows:
        tilt = node_psf(optics, row, integral)[1]
        points.append([o.image(o.transfer(row), point, 2 * tilt - moved) for o in optics])
    write_library(tmp_path, chip, np.array(points), own.nodes_xy, wavelength=own.wavelength / 10)
    psf = read(tmp_path, chip, camera, "point")
    assert psf.wavelength == pytest.approx(own.wavelength)
    assert psf.tilt == pytest.approx(np.tile(moved / 2, (4, 1)), abs=2e-4)  # px
    expected = own.image / own.image.sum(axis=(2, 3), keepdims=True)
    assert np.abs(psf.image - expected).max() < 1e-4 * expected.max()
    wrong = read(tmp_path, chip, camera, "cell_integral")
    assert np.abs(wrong.image - expected).max() > 0.02 * expected.max(), "the two readings differ, and it shows"


def test_a_library_made_constant_by_the_public_script(own, chip, camera, tmp_path):
    """make_constant_psfcube.py: a copy of the file in which each psfMat of every band is one template, float64."""
    write_library(tmp_path, chip, np.array(own.image), own.nodes_xy)
    path = tmp_path / f"psfCube_{chip.id}.h5"
    with h5py.File(path, "r+") as file:
        template = file["w_2/psf_3/psfMat"][...].astype(np.float64)
        file.visititems(lambda name, node: node.__setitem__(..., template) if name.endswith("psfMat") else None)
    psf = read(tmp_path, chip, camera)
    assert psf.nodes_xy == pytest.approx(own.nodes_xy, abs=1e-6), "places stay"
    assert np.ptp(psf.image, axis=(0, 1)).max() == 0
    expected = own.image[3, 2] / own.image[3, 2].sum()
    assert np.abs(psf.image - expected).max() < 2e-3 * expected.max()  # it is centred by itself, no longer with others


def test_unfit_libraries_are_refused(own, chip, camera, tmp_path):
    name = rf"psfCube_{chip.id}\.h5"
    with pytest.raises(InputError, match=rf"{name}: cannot read the PSF file: No such file"):
        read(tmp_path, chip, camera)
    write_library(tmp_path, chip, np.array(own.image), own.nodes_xy)
    good = tmp_path / f"psfCube_{chip.id}.h5"
    shutil.copy(good, tmp_path / "kept")

    def spoil(change, message):
        shutil.copy(tmp_path / "kept", good)
        with h5py.File(good, "r+") as file:
            change(file)
        with pytest.raises(InputError, match=message):
            read(tmp_path, chip, camera)
        assert not (tmp_path / "psf.h5").exists()
        if "no light" not in message:  # a value of the images: they are not read
            with pytest.raises(InputError, match=message):
                check_library(tmp_path, chip, camera.filters["z"])

    def drop(path):
        return lambda file: file.__delitem__(path)

    def put(path, value):
        def change(file):
            del file[path]
            file[path] = value

        return change

    spoil(drop("w_3"), "w_0 ... w_3: not four wavelengths")
    spoil(drop("w_2/psf_3"), "not four wavelengths with the same positions")
    spoil(drop("w_0/psf_1/image_x"), "psf_<j>: no positions; allowed: image_x, image_y or x, y")
    spoil(put("w_0/psf_1/image_x", 4000.0), rf"not on chip {chip.id}")
    spoil(put("w_0/psf_1/image_x", np.nan), rf"not on chip {chip.id}")
    spoil(put("w_1/psf_2/psfMat", np.zeros((256, 256))), "psf_2/psfMat: .*no light")
    spoil(put("w_0/psf_0/psfMat", np.ones((100, 100))), "psfMat: unknown sampling .*allowed: 256, 512")
    spoil(put("w_2/psf_3/psfMat", np.ones((100, 100))), "psf_3/psfMat: not square images of one size")
    spoil(drop("w_2/psf_3/psfMat"), "damaged: KeyError")
    spoil(lambda file: [file[f"w_{i}"].__delitem__("psf_0") for i in range(4)], "no square grid")
    spoil(lambda file: [file.__delitem__(f"w_{i}") for i in range(4)], "w_0: not a PSF library")
    good.write_bytes(good.read_bytes()[:5000])
    with pytest.raises(InputError, match=name):
        read(tmp_path, chip, camera)


def test_a_campaign_takes_its_library(own, tmp_path):
    path = write_campaign(
        tmp_path, psf={"grid": 7, "library": str(tmp_path), "library_sample": "cell_integral"}
    )  # `grid` is of sets made here
    run = OpenCampaign(path)
    chip, job = run.camera.chips[9], run.jobs[0]
    with pytest.raises(InputError, match=r"psfCube_9\.h5: cannot read"):
        psf_stage.psf(run, 9)
    corners = np.array([[0.0, 0.0], [127.0, 0.0], [0.0, 127.0], [127.0, 127.0]])
    with pytest.raises(InputError, match=r"psfCube_9\.h5: cannot read"):
        psf_stage.check_psf(run)
    write_library(tmp_path, chip, np.array(own.image), corners, mm=False)
    psf_stage.check_psf(run)
    psf_stage.psf(run, 9)
    psf = psf_stage.open_psf(run, job.chip)
    assert psf.nodes_xy == pytest.approx(corners)
    assert psf.image.shape == (4, 4, 256, 256)
    assert psf.attributes["filter"] == "r"


@pytest.mark.parametrize("unit", [1e-4, 0.1, 1.0])
@pytest.mark.parametrize("of", ["w", "psf", "dataset"])
def test_wavelengths_in_um_nm_or_angstrom(camera, tmp_path, unit, of):
    """Of the group of a wavelength or of its first place, by number, not by name; without one, the filter's."""
    given = np.array([2550.0, 5000.0, 8800.0, 10300.0])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        names = "w_2", "w_9", "w_10", "w_11"
        for name, value in zip(names[::-1], given[::-1] * unit, strict=True):
            position = file.create_group(f"{name}/psf_0")
            if of == "dataset":
                position["wavelength"] = value
            else:
                (file[name] if of == "w" else position).attrs["wavelength"] = value
        assert _numbered(file, "w", tmp_path / "a.h5") == list(names)
        cubes = [{"psf_0": file[name]["psf_0"]} for name in names]
        found, known = _wavelengths(file, cubes, camera.filters["z"])
        assert found == pytest.approx(given) and known == "the library's"
        part = file["w_9/psf_0"] if of != "w" else file["w_9"]
        if of == "dataset":
            del part["wavelength"]
        else:
            del part.attrs["wavelength"]
        found, known = _wavelengths(file, cubes, camera.filters["z"])
        assert found is camera.filters["z"].psf_wavelength and known == "the filter's"


def test_places_are_sorted_into_rows_whatever_their_order():
    """Rows by y, a little uneven; x fastest."""
    x, y = np.meshgrid([10.0, 500.0, 900.0], [20.0, 700.0, 1500.0])
    nodes = np.stack([x.ravel(), (y + 0.01 * x).ravel()], axis=1)
    mixed = np.random.default_rng(2).permutation(9)
    assert nodes[mixed][_row_by_row(nodes[mixed], 3)].tolist() == nodes.tolist()


def test_a_library_for_another_detector_and_scale(own, chip, camera, tmp_path):
    """Pixels of 20 um and 0.148 arcsec: places in mm lie at half as many pixels from the boresight."""
    other = replace(
        chip, detector=replace(chip.detector, pixel_um=20.0), telescope=replace(chip.telescope, pixel_scale=0.148)
    )
    write_library(tmp_path, other, np.array(own.image), own.nodes_xy)  # as if pixels were 10 um: twice too near
    path = tmp_path / f"psfCube_{chip.id}.h5"
    with h5py.File(path, "r+") as file:
        file.visititems(lambda name, node: node.__setitem__((), 2 * node[()]) if "image_" in name else None)
    psf = read(tmp_path, other, camera)
    assert psf.nodes_xy == pytest.approx(own.nodes_xy, abs=1e-6)
    assert psf.scale == pytest.approx(0.074) and psf.attributes["cell_um"] == 10.0 and psf.oversampling == 2
