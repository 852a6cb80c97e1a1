"""The tables for photons: splines against scipy and the stored cells, alias words decoded, the file."""

import numpy as np
import pytest
import scipy.ndimage
from scipy.interpolate import BSpline

from csstsim.base.errors import InputError
from csstsim.optics.psf.psf_file import PsfSet, write_psf
from csstsim.render.psf_table import make_table, read_tables, spline_coefficients, write_tables

CELL = 1e-6  # of the peak: what a cell's integral may be off (images are float32)
BOX_CELLS = 32


def gaussian(sigma, cells=BOX_CELLS):
    """(4, cells, cells) of sum 1, sigma in cells."""
    at = np.arange(cells) - (cells - 1) / 2
    image = np.exp(-(at**2 + at[:, None] ** 2) / 2 / sigma**2)
    return np.broadcast_to(image / image.sum(), (4, cells, cells))


@pytest.fixture
def small_psf(tmp_path):
    """Return a PsfSet of 2 x 2 nodes whose images are given; None is a dead node."""

    def make(images, name="small.h5"):
        about = {
            "cell_um": 2.5, "cell_arcsec": 0.0185, "oversampling": 4, "chip": 9, "filter": "r", "grid": 2,
            "camera_digest": "none",
        }  # fmt: skip
        nodes = np.array([[0.0, 0.0], [9000.0, 0.0], [0.0, 9000.0], [9000.0, 9000.0]])
        cells = next(i.shape[-1] for i in images if i is not None)
        rows = [(np.full((4, cells, cells), np.nan) if i is None else i, (0, 0)) for i in images]
        write_psf(tmp_path / name, nodes, np.arange(4) + 5000.0, rows, cells=cells, about=about, provenance={})
        return PsfSet(tmp_path / name)

    return make


def decode(words, size):
    """Return the probability of each cell that an alias table of `size` words stands for."""
    kept = np.minimum(words >> 16, 65535) / 65536.0
    p = kept.copy()
    np.add.at(p, words & 0xFFFF, 1 - kept)
    return p / size


def test_coefficients_are_scipys(psf_r):
    for image in psf_r.node(0):
        ours, _ = spline_coefficients(image)
        scipys = scipy.ndimage.spline_filter(image.astype(float), order=3, mode="mirror")
        assert scipys.min() > 0  # nothing was clipped
        scipys *= image.sum(dtype=float) / scipys.sum()  # light that leaks over the box's edge is put back
        assert np.abs(ours - scipys).max() < 1e-12 * scipys.max()


@pytest.mark.parametrize("node", range(4))
def test_density_integrates_to_the_stored_cells(psf_r, node):
    """The integral of sum_k c_k B_2 over a cell is c * (1/6, 4/6, 1/6) along each axis."""
    table = make_table(psf_r, [node])
    for c, image in zip(table.node_coefficients(node), psf_r.node(node), strict=True):
        for axis in (0, 1):
            c = scipy.ndimage.correlate1d(c, [1 / 6, 4 / 6, 1 / 6], axis=axis, mode="mirror")
        assert np.abs(c - image).max() < CELL * image.max()
    assert table.negative[node].max() < 1e-6
    assert table.share[node].sum(axis=1) == pytest.approx(psf_r.flux[node], rel=1e-12)


def test_negative_coefficients_are_clipped_and_counted():
    """A lone cell is no smooth PSF: its spline rings with the prefilter's pole, sqrt(3) - 2, hence signs alternate."""
    image = np.zeros((64, 64), np.float32)
    image[30, 30] = 1
    c, below = spline_coefficients(image)
    pole = np.sqrt(3) - 2
    line = np.sqrt(3) * pole ** np.abs(np.arange(-40, 41))
    expected = -np.minimum(np.outer(line, line), 0).sum()
    assert below == pytest.approx(expected, rel=1e-12)
    assert c.min() == 0 and c.sum() == pytest.approx(1.0, rel=1e-12)


def test_empty_image_has_no_light(small_psf):
    table = make_table(small_psf([gaussian(3.0), gaussian(3.0), gaussian(3.0), np.zeros((4, 32, 32))]), [3])
    assert not table.share.any() and not table.words.any()


@pytest.mark.parametrize("cells", [32, 48, 200])
def test_words_stand_for_the_coefficients(small_psf, cells):
    """Middle and rest, for boxes that are and are not a power of two."""
    table = make_table(small_psf([gaussian(2.5, cells)] * 4))
    inner, outer = table.bits
    assert 2**outer >= cells and 2**inner <= min(cells, 64)
    c = table.node_coefficients(2)[1]
    words = table.words[2, 1].astype(np.int64)
    middle = decode(words[: 4**inner], 4**inner).reshape((2**inner,) * 2) * table.share[2, 1, 0]
    rest = np.zeros((2**outer, 2**outer))
    if table.share[2, 1, 1] > 0:
        rest = decode(words[4**inner :], 4**outer).reshape(rest.shape) * table.share[2, 1, 1]
    assert np.abs(rest[cells:]).max(initial=0) == np.abs(rest[:, cells:]).max(initial=0) == 0
    found = rest[:cells, :cells]
    first = (cells - 2**inner) // 2
    found[first : first + 2**inner, first : first + 2**inner] += middle
    assert found.sum() == pytest.approx(c.sum(), rel=1e-12)
    error = np.abs(found - c) * 4**inner * 2.0**16  # in units of the mean cell's 16-bit steps
    assert np.sort(error, axis=None)[-2] < 1 and error.max() < 2**inner  # one cell takes the rounding of all others


def test_words_give_the_pixels_of_the_density(psf_r):
    """Expected pixel values at a sub-pixel position: alias words and splines by scipy's B-splines, against sums of
    cells where pixels and cells share edges; then the same splines at other phases against the words."""
    table = make_table(psf_r, [1])
    inner, outer = table.bits
    words = table.words[1, 2].astype(np.int64)
    found = decode(words[4**inner :], 4**outer).reshape((256, 256)) * table.share[1, 2, 1]
    found[96:160, 96:160] += decode(words[: 4**inner], 4**inner).reshape((64, 64)) * table.share[1, 2, 0]
    spline = BSpline.basis_element([-1.5, -0.5, 0.5, 1.5], extrapolate=False).antiderivative()
    centre = np.arange(256) + 0.5 - 128
    image = psf_r.node(1)[2].astype(float)
    for phase in (0.0, 0.37, -0.5):  # px, of the star on its pixel
        edges = 4 * (np.arange(-20, 22) - 0.5 - phase)
        inside = spline(np.clip(edges[:, None] - centre, -1.5, 1.5))
        part = np.diff(inside, axis=0)  # of each cell's spline in each pixel
        pixels = np.einsum("ik,jl,kl->ij", part, part, found)
        exact = np.einsum("ik,jl,kl->ij", part, part, table.node_coefficients(1)[2])
        assert np.abs(pixels - exact).max() < 1e-6 * exact.max()
        if phase == -0.5:  # pixel edges on cell edges
            first = round(edges[0]) + 128
            cells = image[first : first + 164, first : first + 164].reshape(41, 4, 41, 4).sum(axis=(1, 3))
            assert np.abs(pixels - cells).max() < 1e-6 * cells.max()


def test_file_holds_what_memory_does(small_psf, tmp_path):
    psf = small_psf([gaussian(2.0), None, gaussian(3.0), gaussian(4.0)])
    write_tables(tmp_path / "deep" / "t.h5", psf)
    read, made = read_tables(tmp_path / "deep" / "t.h5", psf), make_table(psf)
    for name in ("words", "share", "negative"):
        assert np.array_equal(getattr(read, name), getattr(made, name))
        assert not getattr(read, name)[1].any()  # the dead node
    assert isinstance(read.words, np.memmap) and not read.words.flags.writeable
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["t.h5"]


def test_stale_or_damaged_tables_are_refused(small_psf, tmp_path):
    psf = small_psf([gaussian(2.0)] * 4)
    path = tmp_path / "t.h5"
    write_tables(path, psf)
    with pytest.raises(InputError, match="not the tables of this PSF set"):
        read_tables(path, small_psf([gaussian(2.0)] * 3 + [gaussian(2.1) * 0.99], "other.h5"))
    with pytest.raises(InputError, match="not the tables"):
        read_tables(psf.path, psf)
    content = path.read_bytes()
    for size in (0, 100, len(content) // 2):
        path.write_bytes(content[:size])
        with pytest.raises(InputError):
            read_tables(path, psf)
    with pytest.raises(InputError, match="No such file"):
        read_tables(tmp_path / "none.h5", psf)


def test_failed_writing_leaves_nothing(small_psf, tmp_path):
    psf = small_psf([gaussian(2.0)] * 4)
    psf.flux[2] *= 1.5  # as if the image were damaged
    with pytest.raises(InputError, match="does not sum"):
        write_tables(tmp_path / "t.h5", psf)
    assert not list(tmp_path.glob("*t.h5*"))


def test_too_many_cells_are_refused(small_psf):
    with pytest.raises(InputError, match="too many cells"):
        make_table(small_psf([gaussian(2.0, 258)] * 4))
