"""When a brick is good: the thresholds of the report's gates (docs/validation.md), keys of a campaign file."""

from pydantic import Field, field_validator

from csstsim.model import Model


class ValidateConfig(Model):
    """Thresholds of the report's gates; null = the gate is only reported."""

    completeness_min: float | None = Field(
        0.95, ge=0, le=1, description="point sources found at S/N above snr_min; two sigma of chance are forgiven"
    )
    snr_min: float = Field(5.0, gt=0, description="S/N (from truth) above which completeness is judged")
    purity_min: float | None = Field(0.8, ge=0, le=1, description="merged sources with a true object")
    mag_bias_max: float | None = Field(0.02, gt=0, description="|median magnitude residual| of stars at S/N > 20 [mag]")
    pull_width: tuple[float, float] | None = Field(
        (0.9, 1.2), description="least and largest width of stars' flux residuals over their errors, at S/N > 20"
    )
    astrometry_max: float | None = Field(5.0, gt=0, description="median position residual of stars at S/N > 50 [mas]")
    position_bias_max: float | None = Field(
        1.0,
        gt=0,
        description="|median residual| along or across columns, in any bin of S/N above 5 [mas]; 4 sigma of "
        "chance are forgiven",
    )
    depth_off_max: float | None = Field(
        0.3,
        gt=0,
        description="5-sigma depth of an exposure beyond the range of the filter's published limiting magnitudes [mag]",
    )
    counts_max: float | None = Field(
        0.1,
        gt=0,
        description="|sources / true objects - 1| brighter than S/N 50 of a point; 2 sigma of chance are forgiven",
    )
    psf_size_max: float | None = Field(
        0.005, gt=0, description="|median size of stars at S/N > 50 over the PSF model, less 1|, smoothed with 1 px"
    )
    psf_e_max: float | None = Field(
        0.005, gt=0, description="|median distortion (e1, e2) of stars at S/N > 50 less the PSF model's|"
    )
    shear_m_max: float | None = Field(0.05, gt=0, description="|m| of `csstsim shear`; 5 sigma are forgiven")
    shear_c_max: float | None = Field(2e-3, gt=0, description="|c| of `csstsim shear`; 5 sigma are forgiven")

    @field_validator("pull_width")
    @classmethod
    def _rising(cls, value):
        if value is not None and not 0 <= value[0] < value[1]:
            raise ValueError("two numbers, the least first")
        return value
