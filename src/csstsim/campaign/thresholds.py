"""Thresholds of the report's gates (docs/validation.md): keys of a campaign file."""

from typing import Annotated, Self

from pydantic import Field, field_validator

from csstsim.base.model import Model

# Their defaults hold for the embedded sky's density and sizes; a right image of a crowded cluster may not meet them
OF_THE_SKY = (
    "galaxy_completeness_min",
    "galaxy_mag_max",
    "pair_completeness_min",
    "purity_min",
    "counts_max",
    "lost_max",
    "twice_max",
)
Threshold = Annotated[float, Field(gt=0)] | None


class ValidateConfig(Model):
    """Thresholds of the report's gates; null = the gate is only reported.

    With a catalogue of your own, null is the default of those OF_THE_SKY.
    """

    def for_catalogue(self, embedded: bool) -> Self:
        """Return the thresholds that are judged: those OF_THE_SKY for the embedded one, or if they are given."""
        free = () if embedded else set(OF_THE_SKY) - self.model_fields_set
        return self.model_copy(update=dict.fromkeys(free))

    completeness_min: float | None = Field(
        0.95,
        ge=0,
        le=1,
        description="least share of isolated point sources found at S/N above snr_min in an exposure; 2 sigma forgiven",
    )
    galaxy_completeness_min: float | None = Field(
        0.9,
        ge=0,
        le=1,
        description="isolated galaxies found at S/N above galaxy_snr_min in an exposure; two sigma of "
        "chance are forgiven",
    )
    galaxy_snr_min: float = Field(
        20.0, gt=0, description="S/N (from truth) above which galaxies' completeness is evaluated"
    )
    saturated_min: float | None = Field(
        0.9, ge=0, le=1, description="least share of stars of twice the full well that are flagged as saturated"
    )
    snr_min: float = Field(5.0, gt=0, description="S/N (from truth) above which completeness is evaluated")
    purity_min: float | None = Field(0.8, ge=0, le=1, description="least share of merged sources with a true object")
    mag_bias_max: float | None = Field(0.02, gt=0, description="|median magnitude residual| of stars at S/N > 20 [mag]")
    galaxy_mag_max: tuple[Threshold, Threshold, Threshold] | None = Field(
        (0.15, 0.1, 0.05),
        description="|median residual of total magnitudes| of isolated galaxies at a merged S/N of 10 to 20, 20 to 60 "
        "and 60 to 500 [mag]; 2 sigma of chance are allowed",
    )
    galaxy_colour_max: float | None = Field(
        0.03,
        gt=0,
        description="|median colour residual| of isolated galaxies at S/N 10 to 20 and 20 to 500 [mag], in "
        "neighbouring bands; 2 sigma of chance are allowed",
    )
    pair_completeness_min: float | None = Field(
        0.4,
        ge=0,
        le=1,
        description="minimum fraction found of the fainter objects of pairs within 12 px, both above "
        "S/N 8 in an exposure; 2 sigma of chance are allowed",
    )
    frame_counts_max: float | None = Field(
        0.01,
        gt=0,
        description="|number of galaxies, of stars in a frame's truth over that in the catalogue on its "
        "window, less 1|, of the embedded sky",
    )
    laws_max: float | None = Field(
        0.1,
        gt=0,
        description="|number of galaxies, of stars of a brick's truth over that of the laws of the "
        "universe, less 1|, structure included; 4 sigma of chance are allowed",
    )
    pull_width: tuple[float, float] | None = Field(
        (0.9, 1.2), description="least and largest width of stars' flux residuals over their errors, at S/N > 20"
    )
    zeropoint_max: float | None = Field(
        0.01,
        gt=0,
        description="|mean magnitude residual| of an exposure's stars at S/N > 20 [mag]; 4 sigma are forgiven",
    )
    place_max: float | None = Field(
        3.0, gt=0, description="|mean position residual| of an exposure's stars at S/N > 50 [mas]; 4 sigma are forgiven"
    )
    wcs_max: float | None = Field(
        0.05,
        gt=0,
        description="|mean residual| of those stars through the WCS of the Level-0 header [px]; 4 sigma are forgiven",
    )
    astrometry_max: float | None = Field(5.0, gt=0, description="median position residual of stars at S/N > 50 [mas]")
    position_bias_max: float | None = Field(
        1.0,
        gt=0,
        description="|median residual| along or across columns, in any bin of S/N above 5 [mas]; 4 sigma of "
        "chance are forgiven",
    )
    depth_off_max: float | None = Field(
        0.35,
        gt=0,
        description="5-sigma depth of an exposure beyond the range of the filter's published limiting magnitudes [mag]",
    )
    noise_off_max: float | None = Field(
        0.1, gt=0, description="|noise of the background over that of sky, dark, readout and rounding, less 1|; 4 sigma"
    )
    level_off_max: float | None = Field(
        0.01,
        gt=0,
        description="|background over that of sky and dark, less 1|, of the frame and of each channel; light of "
        "objects' wings and 4 sigma are forgiven",
    )
    uneven_max: float | None = Field(
        0.0035,
        gt=0,
        description="|background of a channel over sky and dark, less that of all channels|; light of "
        "objects' wings and 4 sigma are allowed",
    )
    read_noise_max: float | None = Field(
        0.05, gt=0, description="|read noise in a channel's overscan over the camera's, less 1|; 4 sigma are forgiven"
    )
    bias_max: float | None = Field(
        0.5, gt=0, description="|bias in a channel's overscan less the header's| [DN]; 4 sigma are forgiven"
    )
    header_max: float | None = Field(
        1e-4, gt=0, description="|gain, exposure time and read noise of the header over the campaign's, less 1|"
    )
    spectra_flux_max: float | None = Field(
        0.01,
        gt=0,
        description="|mean of stars' extracted over true electrons, less 1| in a spectroscopic exposure, "
        "spectra of S/N > 50; 4 sigma are allowed",
    )
    spectra_sky_max: float | None = Field(
        0.03, gt=0, description="|median of the sky near spectra over the campaign's, less 1|; faint objects add 0.01"
    )
    pointing_max: float | None = Field(
        0.01, gt=0, description="pointing keywords and world coordinates of the header less the campaign's [arcsec]"
    )
    counts_max: float | None = Field(
        0.1,
        gt=0,
        description="|share of isolated true objects with a source, and false sources, - 1| brighter than S/N 20 in "
        "one exposure; 2 sigma of chance are forgiven",
    )
    lost_max: float | None = Field(
        0.02,
        gt=0,
        description="isolated objects that an exposure found at S/N above 20 without a merged source; 2 sigma forgiven",
    )
    twice_max: float | None = Field(
        0.02,
        gt=0,
        description="surplus sources at isolated true objects, over the number of these; 2 sigma forgiven",
    )
    psf_size_max: float | None = Field(
        0.005,
        gt=0,
        description="|median size of an exposure's stars at S/N > 50 over the PSF model, less 1|; 4 sigma are forgiven",
    )
    psf_e_max: float | None = Field(
        0.005,
        gt=0,
        description="|median distortion (e1, e2) of stars at S/N > 50 less the PSF model's|; 4 sigma are forgiven",
    )
    shape_max: float | None = Field(
        0.25,
        gt=0,
        description="|slope of galaxies' measured shapes on the true ones, less 1|, complex: a turn, a sign; S/N > 20; "
        "4 sigma are forgiven",
    )
    shear_m_max: float | None = Field(0.05, gt=0, description="|m| of `csstsim shear`; 5 sigma are forgiven")
    shear_c_max: float | None = Field(2e-3, gt=0, description="|c| of `csstsim shear`; 5 sigma are forgiven")

    @field_validator("pull_width")
    @classmethod
    def _rising(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not 0 <= value[0] < value[1]:
            raise ValueError("must be two numbers, the smaller first")
        return value
