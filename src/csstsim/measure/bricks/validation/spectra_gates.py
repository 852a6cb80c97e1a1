"""Gates of a spectroscopic frame, from what is written with its spectra (stages.parts.spectra_checks)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from csstsim.measure.bricks.validation.gates import WORST, at_most

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.measure.bricks.validation.gates import Gate


def spectra_gates(checks: Mapping[str, Any], limits: ValidateConfig, **where: Any) -> list[Gate]:
    """Return the gates of a frame's `checks`; limits: thresholds.ValidateConfig; where: its band, exposure and chip."""
    flux = checks["flux"]
    sky = checks["sky"]
    band = where.pop("band")
    pointing = max(checks["pointing"].values(), default=None)
    return [
        at_most(
            "flux of spectra over true, less 1", band, flux["off"], limits.spectra_flux_max, flux["n"],
            WORST * flux["error"], WORST, **where,
        ),
        at_most(
            "sky near spectra over the campaign's, less 1", band, sky["off"], limits.spectra_sky_max, sky["n"],
            **where,
        ),
        at_most("header: pointing less the campaign's [arcsec]", band, pointing, limits.pointing_max, None, **where),
    ]  # fmt: skip
