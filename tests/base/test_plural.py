"""Counts in messages."""

from csstsim.base.plural import number_of


def test_one_is_singular():
    assert [number_of(n, "chip") for n in (0, 1, 2)] == ["0 chips", "1 chip", "2 chips"]
    assert number_of(1, "spectrum", "spectra") == "1 spectrum" and number_of(3, "spectrum", "spectra") == "3 spectra"
