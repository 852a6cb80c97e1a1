"""Gates of a spectroscopic frame, each number worked out by hand."""

import pytest

from csstsim.campaign.thresholds import ValidateConfig
from csstsim.measure.bricks.validation.gates.register import evaluate

LIMITS = ValidateConfig(spectra_flux_max=0.02, spectra_sky_max=0.04, pointing_max=0.5)
CHECKS = {
    "flux": {"off": -0.05, "n": 120, "error": 0.005}, "sky": {"off": 0.05, "n": 60, "error": 1.0},
    "pointing": {"RA_OBJ": 0.1, "DEC_OBJ": 0.25, "CRVAL1": 0.2},
}  # fmt: skip


def test_flux_sky_and_pointing_have_thresholds_of_their_own():
    """Flux: 0.05 against 0.02 and four errors of 0.005; sky: no tolerance; pointing: the keyword furthest off."""
    where = {"band": "gi", "exposure": "42", "chip": 10}
    assert evaluate("spectra", CHECKS, LIMITS, **where) == [
        where | {
            "name": "flux of spectra over true, less 1", "value": -0.05, "threshold": 0.02, "n": 120,
            "error": pytest.approx(0.005), "margin": pytest.approx(1.25), "passed": False,
        },
        where | {
            "name": "sky near spectra over the campaign's, less 1", "value": 0.05, "threshold": 0.04, "n": 60,
            "error": None, "margin": pytest.approx(1.25), "passed": False,
        },
        where | {
            "name": "header: pointing less the campaign's [arcsec]", "value": 0.25, "threshold": 0.5, "n": None,
            "error": None, "margin": pytest.approx(0.5), "passed": True,
        },
    ]  # fmt: skip


@pytest.mark.parametrize(("expected", "margin"), [(3.0, 0.25 / (0.04 + 0.1)), (60.0, 0.25 / (0.04 + 0.005))])
def test_the_sky_may_have_the_light_of_faint_objects(expected, margin):
    """0.3 electron a pixel, a tenth of a dark sky and a two hundredth of a bright one."""
    sky = {"off": 0.25, "n": 60, "expected": expected}
    _, gate, _ = evaluate("spectra", CHECKS | {"sky": sky}, LIMITS, "gu")
    assert gate["margin"] == pytest.approx(margin)


def test_what_is_unknown_is_not_evaluated():
    none = {"off": None, "n": 0, "error": 0.0}
    gates = evaluate("spectra", {"flux": none, "sky": none, "pointing": {}}, LIMITS, "gi")
    assert [gate["passed"] for gate in gates] == [None] * 3 and [gate["value"] for gate in gates] == [None] * 3
