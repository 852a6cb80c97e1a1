"""Pictures of the report: what a photograph and a chart keep, and how small they are."""

import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from csstsim.report.figures import png
from csstsim.report.pictures import chart, photograph


def pixels_of(picture):
    image = Image.open(io.BytesIO(picture))
    assert image.format == "WEBP"
    return np.asarray(image.convert("RGB")).astype(int)


@pytest.mark.parametrize("shape", [(40, 20), (40, 20, 3)])
def test_a_photograph_has_its_first_row_at_the_bottom(shape):
    tall = np.zeros(shape, np.uint8)
    tall[:10, :10] = 255
    picture = pixels_of(photograph(tall))
    assert picture.shape == (40, 20, 3) and picture[-5, 3].min() > 200 and picture[[5, -5], [3, 15]].max() < 50


def test_a_chart_keeps_its_white_its_black_and_every_colour_of_a_line():
    """A rare colour is kept, too: no colour moves by more than half a level, 255 / 63 / 2."""
    figure = Figure(figsize=(4, 3))
    axes = figure.subplots()
    axes.imshow(np.random.default_rng(1).normal(size=(40, 60)), cmap="gray", aspect="auto")
    axes.plot([0, 50], [1, 1], color="#E69F00")
    axes.plot([0, 5], [2, 2], color="#CC79A7")
    before = png(figure)
    picture = pixels_of(chart(before))
    original = pixels_of_png(before)
    assert np.abs(picture - original).max() <= 2 and (picture[0, 0] == 255).all()
    assert len(chart(before)) < 0.8 * len(before)


def pixels_of_png(picture):
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
