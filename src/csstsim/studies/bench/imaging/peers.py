"""Other codes, and the paper's method, as `prepare(setting, case) -> draw(copies)` (see methods.py).

* `paper`: GalSim as the paper describes it (sections 4.1, 5.3). For each object and sub-band the PSF is interpolated to
  the object's position; its cells become an InterpolatedImage (samples of a continuous PSF), which is convolved with
  the object and rendered.
* `fft`, `photons`: GalSim with one PSF object per node, used for all objects nearest to that node.

GalSim's defaults hold everywhere (folding_threshold 5e-3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import galsim
import numpy as np

from csstsim.base.types import FloatArray
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.parts.spots import in_pixels

if TYPE_CHECKING:
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.imaging.cases import Case
    from csstsim.studies.bench.setting import Setting
    from csstsim.studies.bench.sweep import Draw

BANDS = 4


def galaxy_of(scene: Scene) -> galsim.GSObject | None:
    """Return the profile of a Scene's one object in pixels, of unit flux; None for a point."""
    parts = []
    for row, fraction in enumerate([1.0] if scene.fraction_of_parent is None else scene.fraction_of_parent):
        profile = _of_spots(scene, row) if scene.spot is not None and scene.spot[row] >= 0 else _sersic(scene, row)
        if profile is not None and fraction > 0:
            offset = scene.x[row] - scene.x[0], scene.y[row] - scene.y[0]
            parts.append(profile.transform(*scene.matrix[row].ravel()).withFlux(fraction).shift(*offset))
    if len(parts) < 2:  # GalSim's photons of a Sum of one image have 1.6 times its flux
        return parts[0].withFlux(1.0) if parts else None
    return galsim.Sum(parts).withFlux(1.0)


def _sersic(scene: Scene, row: int) -> galsim.GSObject | None:
    profiles = {1.0: galsim.Exponential, 4.0: galsim.DeVaucouleurs}
    parts = [
        profiles.get(index, partial(galsim.Sersic, index))(half_light_radius=size, flux=flux)
        for flux, (index, _, size) in zip(scene.component_fractions[row], scene.sersic[row], strict=True)
        if flux > 0 and index > 0
    ]
    return galsim.Sum(parts) if parts else None


def _of_spots(scene: Scene, row: int) -> galsim.GSObject:
    """Return knots as points, or an image as GalSim's InterpolatedImage."""
    spots = scene.spots
    spot = scene.spot
    assert spots is not None and spot is not None  # of a row with spots
    group = int(spot[row])
    image = spots.image(group)
    if image is not None:
        return galsim.InterpolatedImage(galsim.ImageD(in_pixels(image)), scale=1.0)
    u, v, flux = spots.group(group)
    return galsim.Sum([galsim.DeltaFunction(flux=f).shift(x, y) for x, y, f in zip(u, v, flux, strict=True)])


def interpolated(cells: FloatArray, per_pixel: int) -> galsim.InterpolatedImage:
    """Return the PSF of `cells` (ny, nx), `per_pixel` along a pixel, as GalSim's InterpolatedImage; lengths in px."""
    return galsim.InterpolatedImage(
        galsim.ImageD(cells), scale=1 / per_pixel, flux=cells.sum(), x_interpolant="quintic"
    )


def _drawer(case: Case, profiles: Sequence[Callable[[], galsim.GSObject]], **options: Any) -> Draw:
    """Return a draw that adds the profiles, which are functions without arguments: making them is part of the cost."""
    scene = case.scene
    window = case.window
    bounds = galsim.BoundsI(window.x0, window.x1 - 1, window.y0, window.y1 - 1)
    centre = galsim.PositionD(scene.x[0], scene.y[0])

    def draw(copies: int) -> FloatArray:
        image = galsim.ImageD(bounds, init_value=0)
        for _ in range(copies):
            for profile in profiles:
                profile().drawImage(image, scale=1.0, center=centre, add_to_image=True, **options)
        return image.array

    return draw


def paper(setting: Setting, case: Case) -> Draw:
    """Return draw(copies) by the paper's method: one PSF object for each object and sub-band."""
    scene = case.scene
    per_pixel = setting.psf.oversampling

    def profile(band: int) -> galsim.GSObject:
        cells = sum(w * setting.psf.node(n)[band] for n, w in zip(scene.node[0], scene.weight[0], strict=True))
        point = interpolated(cells, per_pixel) * scene.electrons[:, band].sum()
        galaxy = galaxy_of(scene)
        return point if galaxy is None else galsim.Convolve(galaxy, point)

    return _drawer(case, [partial(profile, band) for band in range(BANDS)])


def _nearest(setting: Setting, case: Case) -> FloatArray:
    """Return the cells of the node nearest to the object, summed over the sub-bands, in electrons."""
    scene = case.scene
    distance = np.hypot(*(setting.psf.nodes_xy - (scene.x[0], scene.y[0])).T)
    return np.tensordot(scene.electrons.sum(axis=0), setting.psf.node(distance.argmin()).astype(float), axes=1)


def fft(setting: Setting, case: Case) -> Draw:
    """Return draw(copies) by GalSim's FFT, with the nearest node's PSF, which includes the pixel."""
    per_pixel = setting.psf.oversampling
    response = pixel_response(_nearest(setting, case), per_pixel)
    point = galsim.InterpolatedImage(
        galsim.ImageD(response), scale=1 / per_pixel, normalization="sb", x_interpolant="quintic"
    )
    return _drawer(case, [_convolved(case.scene, point)], method="no_pixel")


def _convolved(scene: Scene, point: galsim.GSObject) -> Callable[[], galsim.GSObject]:
    galaxy = galaxy_of(scene)
    return (lambda: point) if galaxy is None else lambda: galsim.Convolve(galaxy_of(scene), point)


def photons(setting: Setting, case: Case) -> Draw:
    """Return draw(copies) by GalSim's photon shooting, with the nearest node's PSF."""
    point = interpolated(_nearest(setting, case), setting.psf.oversampling)
    rng = galsim.BaseDeviate(case.id + 1)
    return _drawer(case, [_convolved(case.scene, point)], method="phot", rng=rng)
