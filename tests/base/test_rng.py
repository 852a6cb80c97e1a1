"""Streams named by words: equal words give equal numbers, other words other numbers."""

import numpy as np
import pytest

from csstsim.base.rng import Streams, stream


def first(generator):
    return int(generator.integers(2**63))


def test_same_words_same_numbers_and_every_word_counts():
    base = first(stream(1, "exposure", "10100000001", 8, "bias"))
    assert base == first(stream(1, "exposure", "10100000001", 8, "bias"))
    assert (
        len({first(stream(seed, "chip", chip, ch)) for seed in (1, 2) for chip in range(1, 31) for ch in range(16)})
        == 960
    )


def test_no_collision_where_sums_collide():
    streams = {first(Streams(7, "1", chip, "gain").channel(ch, "gain")) for chip in range(1, 31) for ch in range(1, 17)}
    assert len(streams) == 480


def test_lifetimes():
    a, b = Streams(1, "101", 8, "bias"), Streams(1, "102", 8, "gain")
    assert first(a.chip("prnu")) == first(b.chip("prnu"))  # fixed for the chip, whichever layer or exposure asks
    assert first(a.channel(3, "gain")) == first(b.channel(3, "gain"))
    assert first(a.camera("vignette")) == first(Streams(1, "9", 20, "x").camera("vignette"))
    assert first(a.exposure("noise")) != first(Streams(1, "102", 8, "bias").exposure("noise"))
    assert first(a.object(5)) != first(a.object(6))


def test_the_streams_of_another_layer_are_those_it_gets_itself():
    """In the same exposure and chip; the layer that asks for them keeps its own."""
    own, other = (Streams(1, "101", 8, keyword) for keyword in ("bias", "gain"))
    asked = own.layer("gain")
    for draw in (
        lambda s: first(s.exposure("x")), lambda s: int(s.exposure_key("x")), lambda s: first(s.chip("x")),
        lambda s: first(s.channel(3, "x")), lambda s: first(s.camera("x")), lambda s: first(s.object(7)),
    ):  # fmt: skip
        assert draw(asked) == draw(other)
    assert first(own.exposure("x")) == first(Streams(1, "101", 8, "bias").exposure("x")) != first(asked.exposure("x"))


def test_words_cannot_hide_a_separator():
    with pytest.raises(ValueError, match="'/'"):
        stream(1, "a/b")


def test_the_global_state_is_untouched():
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - this is what must not change
    stream(1, "x").normal(size=10)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_a_draw_lives_as_long_as_its_method_says_and_no_longer():
    """Each method: which of seed, exposure, chip, layer and name change its numbers."""
    base = {"seed": 1, "obsid": "101", "chip_id": 8, "keyword": "bias"}
    others = {"seed": 2, "obsid": "102", "chip_id": 9, "keyword": "gain"}
    methods = {
        "exposure": (lambda s: first(s.exposure("x")), {"seed", "obsid", "chip_id", "keyword"}),
        "exposure_key": (lambda s: int(s.exposure_key("x")), {"seed", "obsid", "chip_id", "keyword"}),
        "chip": (lambda s: first(s.chip("x")), {"seed", "chip_id"}),
        "chip_key": (lambda s: int(s.chip_key("x")), {"seed", "chip_id"}),
        "channel": (lambda s: first(s.channel(3, "x")), {"seed", "chip_id"}),
        "camera": (lambda s: first(s.camera("x")), {"seed"}),
        "object": (lambda s: first(s.object(7)), {"seed", "obsid", "chip_id"}),
    }
    for name, (draw, hangs_on) in methods.items():
        here = draw(Streams(**base))
        changed = {key for key, value in others.items() if draw(Streams(**base | {key: value})) != here}
        assert changed == hangs_on, name
