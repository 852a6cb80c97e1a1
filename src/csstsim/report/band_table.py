"""Tables of a brick's numbers by band, for the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.report.parts import Table

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Any

KRON = (
    "Stars have PSF magnitudes, galaxies total magnitudes. Kron magnitudes of the same galaxies miss the flux beyond "
    "the ellipse; the last column gives their residual."
)


def band_table(result: Mapping[str, Any], labels: Mapping[str, str]) -> Table:
    """Return the Table of a validate_brick result's main numbers, one row per band, in magnitudes.

    labels: {band: its name as the camera writes it}.
    """
    rows = []
    for band, numbers in result["bands"].items():
        star = numbers["star"]
        galaxy = numbers["galaxy"]
        rows.append((
            labels.get(band, band), numbers["frames"], _fixed(numbers["zeropoint"]), _fixed(numbers["depth_5sigma"]),
            _fixed(numbers["completeness"], 3), numbers["point_sources"], _fixed(star["median"], 4),
            _spread(star), star["n"],
            _fixed(galaxy["median"], 3), _spread(galaxy), galaxy["n"], _fixed(numbers["galaxy_kron"]["median"], 3),
        ))  # fmt: skip
    head = (
        "band", "frames", "zero point [AB, 1 e-/s]", "5 sigma depth [AB]", "completeness", "point sources",
        "stars: out - in [mag]", "scatter", "stars", "galaxies: out - in [mag]", "scatter", "galaxies",
        "galaxies, Kron: out - in [mag]",
    )  # fmt: skip
    return Table(head, rows)


def band_numbers(result: Mapping[str, Any], labels: Mapping[str, str]) -> Table:
    """Return the Table of all numbers of a result's bands: one row per number, one column per band."""
    columns = {band: dict(_leaves(numbers)) for band, numbers in result["bands"].items()}
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    rows = [(name, *(column.get(name) for column in columns.values())) for name in names]
    return Table(("number", *(labels.get(band, band) for band in columns)), rows, "numbers")


def _leaves(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float | str | None]]:
    """Yield (name, number) of nested mappings; lists are left out: they hold curves, which the figures show."""
    for key, value in mapping.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}: ")
        elif value is None or isinstance(value, (int, float, str)):
            yield prefix + key, value


def _fixed(value: float | None, digits: int = 2) -> str | None:
    return None if value is None else f"{value:.{digits}f}"


def _spread(numbers: Mapping[str, Any]) -> str | None:
    return _fixed(numbers["sigma"], 3) if numbers["n"] >= 3 else None  # one or two sources have no useful scatter
