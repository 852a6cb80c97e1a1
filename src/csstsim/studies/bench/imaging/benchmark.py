"""The benchmark of imaging: `csstsim bench` with an imaging filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.studies.bench.imaging.cases import make_cases
from csstsim.studies.bench.imaging.measures import NAMES, WINDOW_PX, errors
from csstsim.studies.bench.imaging.methods import METHODS, standard
from csstsim.studies.bench.imaging.shapes import make_shapes
from csstsim.studies.bench.imaging.truth import Truth
from csstsim.studies.bench.sweep import Bench

if TYPE_CHECKING:
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.imaging.cases import Case
    from csstsim.studies.bench.setting import Setting

GOALS = {"flux": 1e-3, "x_mas": 1.0, "y_mas": 1.0, "size2": 1e-3, "e1": 1e-4, "e2": 1e-4}


def case_errors(
    setting: Setting, case: Case, image: FloatArray, truth: FloatArray, drawn: float
) -> tuple[FloatArray, FloatArray]:
    """Return bench.imaging.measures.errors of a Case."""
    box = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling
    scale = 1000 * setting.camera.telescope.pixel_scale
    how = {"box": box, "sigma": max(WINDOW_PX, half_light_px(case.scene)), "mas_per_px": scale}
    return errors(image, truth, setting.variance, case.electrons, drawn, **how)


def half_light_px(scene: Scene) -> float:
    """Return the half-light radius [px] of the larger component of a Scene's one object, as a circle of equal area."""
    radius = np.where(scene.component_fractions[0] > 0, scene.sersic[0, :, 2], 0.0).max()
    return float(radius * np.sqrt(abs(np.linalg.det(scene.matrix[0]))))


SHOWN = "flux", "x_mas", "size2", "e1"
IMAGING = Bench(METHODS, make_cases, Truth, standard, case_errors, NAMES, GOALS, SHOWN)
_ANY_SHAPE = tuple(method for method in METHODS if method.name != "UFig")
SHAPES = Bench(_ANY_SHAPE, make_shapes, Truth, standard, case_errors, NAMES, GOALS, SHOWN)
