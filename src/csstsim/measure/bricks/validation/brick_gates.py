"""Gates of a brick: those that combine all exposures of a band, and those of the merged catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.measure.bricks.validation.gates import CHANCE, FEW, WORST, at_least, at_most

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.measure.bricks.validation.gates import Gate


def band_gates(band: str, numbers: Mapping[str, Any], config: ValidateConfig) -> list[Gate]:
    """Return the gates of a band that combine all its exposures."""
    star = numbers["star"]
    counts = numbers["counts"]
    n = numbers["point_sources"]
    # The worst bin, less the tolerance for chance
    bias = [part[name] for part in numbers["transfer"] for name in ("deferred_mas", "across_mas")]
    bias = [max(abs(part["median"]) - WORST * part["error"], 0.0) for part in bias if part["n"] >= FEW]
    galaxies = [
        at_most(
            "magnitude bias of galaxies, S/N {:g} to {:g} [mag]".format(*part["snr"]),
            band,
            part["median"],
            most,
            part["n"],
            CHANCE * (part["error"] or 0.0),
        )
        for part, most in zip(numbers["galaxy_bins"], config.galaxy_mag_max or (None, None, None), strict=True)
    ]
    found = numbers["pairs"]["found"]
    pairs = numbers["pairs"]["n"]
    return [
        *galaxies,
        at_least(
            "completeness of the fainter of close pairs",
            band,
            found / pairs if pairs else None,
            config.pair_completeness_min,
            pairs,
        ),
        at_most("magnitude bias of stars", band, star["median"], config.mag_bias_max, star["n"]),
        at_most("position bias, any S/N [mas]", band, max(bias, default=None), config.position_bias_max, n),
        fraction_at_most("number counts, out / in - 1", counts["excess"], counts["n"], config.counts_max)
        | {"band": band},
    ]


def colour_gate(part: Mapping[str, Any], most: float | None) -> Gate:
    """Return the gate of galaxies' colours in two bands and a bin of S/N."""
    low, high = part["snr"]
    return at_most(
        f"colour bias of galaxies, S/N {low:g} to {high:g} [mag]",
        " - ".join(part["bands"]),
        part["median"],
        most,
        part["n"],
        CHANCE * (part["error"] or 0.0),
    )


def law_gates(laws: Mapping[str, tuple[float, float]], config: ValidateConfig) -> list[Gate]:
    """Return the gates of the numbers of a brick's objects against those of the universe's laws."""
    return [
        at_most(
            f"{kind} of the brick over the universe's laws, less 1",
            "all",
            number / expected - 1,
            config.laws_max,
            None,
            WORST * expected**-0.5,
            WORST,
        )
        for kind, (number, expected) in laws.items()
        if expected > 0
    ]


def fraction_at_most(name: str, fraction: float | None, n: int, most: float | None) -> Gate:
    """Return the gate of a fraction of n that is at most `most`, with a tolerance for chance."""
    return at_most(name, "all", fraction, most, n, CHANCE * np.sqrt(most / n) if most and n else 0.0)
