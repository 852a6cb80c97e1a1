"""PSF photometry of a known Gaussian: effective area in closed form; errors of partly lost light."""

import numpy as np
import pytest
from slitless import below

from csstsim.measure.catalogue import point_source_snr
from csstsim.measure.light.photometry import fit_sources, psf_model

SIGMA = 5.0
STAR = 0.95  # px, sigma of the fabricated PSF


def test_effective_pixels_in_closed_form(fabricate):
    """1 / sum p^2 of a Gaussian integrated over pixels, the light beyond the table left out."""
    line = np.diff(below(np.arange(-12, 14) - 0.5, STAR))
    model = psf_model(fabricate.psf, (0, 0), (200, 200))
    assert model.n_eff == pytest.approx(1 / ((line**2).sum() ** 2 * fabricate.LIGHT**2), rel=0.01)


@pytest.mark.parametrize("share", [1.0, 0.25])
@pytest.mark.parametrize("flux", [300.0, 20_000.0])
def test_flux_errors_are_the_scatter_where_light_was_lost(fabricate, share, flux):
    """400 stars of whose light a share was counted, divided by it: pulls of width 1, and the formula's S/N."""
    image = np.zeros((640, 640))
    x, y = (v.ravel().astype(float) for v in np.meshgrid(np.arange(20, 620, 30), np.arange(20, 620, 30)))
    x, y = x + 0.3, y - 0.2
    fabricate.add_stars(image, x, y, np.full(len(x), flux))
    rng = np.random.default_rng(68)
    counted = rng.poisson(share * (image + fabricate.SKY)) + rng.normal(0, fabricate.READ_NOISE, image.shape)
    frame = (counted / share - fabricate.SKY).astype(np.float32)
    variance = (share * fabricate.SKY + fabricate.READ_NOISE**2) / share**2
    rms = np.full(frame.shape, np.sqrt(variance), np.float32)
    model = psf_model(fabricate.psf, (0, 0), frame.shape)
    fit = fit_sources(
        frame, rms, np.zeros(frame.shape, np.uint8), x, y, np.full(len(x), share), model.cell(x, y), model.coefficients,
        model.blurred,
    )  # fmt: skip
    pull = (fit[:, 0] - flux) / fit[:, 1]
    assert pull.std() == pytest.approx(1.0, abs=SIGMA / np.sqrt(2 * len(x)))
    # One weight for all pixels is at most a third worse than the optimal ones
    optimal = flux / point_source_snr(flux * share, variance * share**2, model.n_eff[0])
    assert 0.95 < np.median(fit[:, 1]) / optimal < 1.35


def test_the_psf_of_a_cell_is_that_of_its_middle(fabricate):
    """Two by two cells of a frame that begins at pixel 1000, 2000: asked for where their pixels' middle lies."""
    asked = []

    class Recorder(type(fabricate.psf)):
        def at(self, x, y):
            asked.append((x, y))
            return super().at(x, y)

    model = psf_model(Recorder(), (1000, 2000), (600, 600), cell_px=300)
    middles = [(1000 + x, 2000 + y) for y in (149.5, 449.5) for x in (149.5, 449.5)]
    assert sorted(asked) == sorted(middles)
    cells = model.cell(*np.transpose(middles))
    assert sorted(cells.tolist()) == list(range(len(middles)))
    for number, place in zip(cells, middles, strict=True):
        assert asked[number] == place
