"""Gates of a spectroscopic frame, from what is written with its spectra (stages.parts.spectra_checks)."""

from typing import Any

from csstsim.bricks.validation.gates import WORST, at_most


def spectra_gates(checks: dict[str, Any], limits: Any, **where: Any) -> list[dict[str, Any]]:
    """Return the gates of a frame's `checks`; limits: thresholds.ValidateConfig; where: its band, exposure and chip."""
    flux, sky, band = checks["flux"], checks["sky"], where.pop("band")
    pointing = max(checks["pointing"].values(), default=None)
    return [
        at_most(
            "flux of spectra over true, less 1", band, flux["off"], limits.spectra_flux_max, flux["n"],
            WORST * flux["error"], WORST, **where,
        ),
        at_most(
            "sky beside spectra over the campaign's, less 1", band, sky["off"], limits.spectra_sky_max, sky["n"],
            **where,
        ),
        at_most("header: pointing less the campaign's [arcsec]", band, pointing, limits.pointing_max, None, **where),
    ]  # fmt: skip
