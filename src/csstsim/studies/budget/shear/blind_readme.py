"""The README of a blind test's folder: everything that a reader with this folder alone needs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.studies.budget.shear.frames import Field
    from csstsim.studies.budget.shear.plan import ShearPlan

TEXT = """\
# Frames of a hidden shear

{fields} frames of galaxies, field_000.fits to field_{last:03d}.fits. In each, all galaxies have one shear g1, g2,
which only a key file has. Each component is between -{largest:g} and {largest:g}. seal.json has the SHA-256 digest of
the key, so the key cannot be changed.

## A frame

| HDU | unit | what |
|---|---|---|
| IMAGE | electron | the frame, less the sky's level |
| PSF | none | [galaxy, y, x]: a star's stamp for each row of GALAXIES |
| GALAXIES | | a row for each galaxy of the sample; neighbours have none |

The exposure is of {exptime:g} s in band {band}. The gain is 1: IMAGE has electrons. Their AB magnitude is
{zeropoint:.4f} - 2.5 log10(electrons). The star of a PSF stamp of s pixels is on the middle of pixel [s/2, s/2],
counted from 0. The stamp's sum is 1. Noise is that of photons, dark current and readout. Pixels without galaxies show
how large it is.

| column of GALAXIES | unit | what |
|---|---|---|
| x, y | pixel | the galaxy's position; (0, 0) is the middle of the first pixel, which is IMAGE[0, 0] |
| jacobian | pixel / arcsec | [[dx/deast, dx/dnorth], [dy/deast, dy/dnorth]] |

`jacobian` goes from the sky to pixels: jacobian times a step (east, north) is the step (x, y). Galaxies come in rings
of four rows, turned by 0, 45, 90 and 135 degrees before the shear. So the mean shape of a ring is that of the shear.

## The answer

g1, g2 are the reduced shear on axes of the sky. g1 > 0 stretches along east, g2 > 0 along north-east. So shapes in
pixels are turned to the sky by `jacobian` first. An answer is a CSV file with a row for each frame:

    field,g1,g2,g1_err,g2_err
    0,0.0123,-0.0045,0.0011,0.0011

`field` is the number in the file's name. Errors are of one sigma, above 0. Whoever has the key scores it:

    csstsim budget shear --reveal KEY answer.csv --output THIS_FOLDER

For each component, answer = (1 + m) g + c is fitted, with the weights of the answer's errors. Printed are m, c, their
errors and the chi-square of the answer against the true shears.
"""


def readme(plan: ShearPlan, field: Field) -> str:
    """Return the text, for frames of a plan; field: any one of them."""
    job = field.job(False)
    return TEXT.format(
        fields=plan.fields,
        last=plan.fields - 1,
        largest=2 * plan.shear,
        band=field.band,
        exptime=job.exposure.exptime,
        zeropoint=zeropoint(field),
    )


def zeropoint(field: Field) -> float:
    """Return the AB magnitude of one electron in the exposure."""
    exposure = field.job(False).exposure
    return exposure.filter.zeropoint(field.simulation._run.camera.telescope) + 2.5 * math.log10(exposure.exptime)
