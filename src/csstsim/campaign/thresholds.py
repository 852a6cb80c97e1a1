"""Thresholds of the report's gates (docs/validation.md): keys of a campaign file."""

from typing import Annotated, Self

from pydantic import Field, field_validator

from csstsim.base.model import Model

# Their defaults hold for the density and sizes of the embedded sky; a correct image of a crowded cluster may fail them
ONLY_EMBEDDED_SKY = (
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
    """Thresholds of the report's gates. A gate whose threshold is null is reported, but not evaluated."""

    def for_catalogue(self, embedded: bool) -> Self:
        """Return the thresholds that apply: for a user's catalogue, those of ONLY_EMBEDDED_SKY only if they are set."""
        removed = () if embedded else set(ONLY_EMBEDDED_SKY) - self.model_fields_set
        return self.model_copy(update=dict.fromkeys(removed))

    completeness_min: float | None = Field(
        0.95,
        ge=0,
        le=1,
        description="Fraction, 0 to 1. Minimum completeness of isolated point sources in an exposure, at true S/N from "
        "snr_min to 500. The tolerance for chance is 2 sigma.",
    )
    galaxy_completeness_min: float | None = Field(
        0.9,
        ge=0,
        le=1,
        description="Fraction, 0 to 1. Minimum completeness of isolated galaxies in an exposure, at true S/N from "
        "galaxy_snr_min to 500. The tolerance for chance is 2 sigma. For a catalogue of your own the default is null.",
    )
    galaxy_snr_min: float = Field(
        20.0, gt=0, description="S/N, above 0. Minimum true S/N of the galaxies in galaxy_completeness_min."
    )
    saturated_min: float | None = Field(
        0.9,
        ge=0,
        le=1,
        description="Fraction, 0 to 1. Minimum fraction with the saturation flag, of the stars whose brightest pixel "
        "has twice the full well. The tolerance for chance is 2 sigma.",
    )
    snr_min: float = Field(
        5.0, gt=0, description="S/N, above 0. Minimum true S/N of the point sources in completeness_min."
    )
    purity_min: float | None = Field(
        0.8,
        ge=0,
        le=1,
        description="Fraction, 0 to 1. Minimum fraction of merged sources with a true object. For a catalogue of your "
        "own the default is null.",
    )
    mag_bias_max: float | None = Field(
        0.02,
        gt=0,
        description="mag, above 0. Maximum absolute median of measured minus true magnitude, of stars at S/N above 20.",
    )
    galaxy_mag_max: tuple[Threshold, Threshold, Threshold] | None = Field(
        (0.08, 0.04, 0.03),
        description="mag, three numbers above 0. Maximum absolute median of measured minus true total magnitude, of "
        "isolated galaxies. The numbers are for a merged S/N of 10 to 20, 20 to 60 and 60 to 500. The tolerance for "
        "chance is 2 sigma. For a catalogue of your own the default is null.",
    )
    galaxy_colour_max: float | None = Field(
        0.03,
        gt=0,
        description="mag, above 0. Maximum absolute median of measured minus true colour in neighbouring bands, of "
        "isolated galaxies at S/N 10 to 20 and 20 to 500. The tolerance for chance is 2 sigma.",
    )
    pair_completeness_min: float | None = Field(
        0.4,
        ge=0,
        le=1,
        description="Fraction, 0 to 1. Minimum completeness of the fainter object of pairs closer than 12 px, both at "
        "S/N above 8 in an exposure. The tolerance for chance is 2 sigma. For a catalogue of your own the default is "
        "null.",
    )
    frame_counts_max: float | None = Field(
        0.01,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the numbers of objects in a frame's truth "
        "table and in the catalogue on its window. Galaxies and stars are compared separately. Only for the embedded "
        "universe.",
    )
    laws_max: float | None = Field(
        0.1,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the numbers of objects in a truth brick "
        "and the number expected from the laws of the universe. Galaxies and stars are compared separately. The "
        "tolerance is 4 sigma, of chance and, for galaxies, of large-scale structure.",
    )
    pull_width: tuple[float, float] | None = Field(
        (0.9, 1.2),
        description="Two numbers, rising, from 0. Minimum and maximum width of the distribution of (measured - true "
        "flux) / error, of stars at S/N above 20. A width of 1 means correct errors.",
    )
    zeropoint_max: float | None = Field(
        0.01,
        gt=0,
        description="mag, above 0. Maximum absolute mean of measured minus true magnitude of an exposure's stars at "
        "S/N above 20. The tolerance for chance is 4 sigma.",
    )
    place_max: float | None = Field(
        3.0,
        gt=0,
        description="mas, above 0. Maximum astrometric offset of an exposure: the mean of measured minus true position "
        "of its stars at S/N above 50. The tolerance for chance is 4 sigma.",
    )
    wcs_max: float | None = Field(
        0.05,
        gt=0,
        description="px, above 0. Maximum mean of measured minus true position of the same stars, by the WCS in the "
        "Level-0 header. The tolerance for chance is 4 sigma.",
    )
    astrometry_max: float | None = Field(
        5.0,
        gt=0,
        description="mas, above 0. Maximum median distance of measured from true positions, of stars at S/N above 50.",
    )
    position_bias_max: float | None = Field(
        1.0,
        gt=0,
        description="mas, above 0. Maximum absolute median of measured minus true position along and across columns, "
        "in each bin of S/N above 5. The tolerance for chance is 4 sigma.",
    )
    depth_off_max: float | None = Field(
        0.35,
        gt=0,
        description="mag, above 0. Maximum distance of an exposure's 5-sigma depth from the range of the filter's "
        "published limiting magnitudes.",
    )
    noise_off_max: float | None = Field(
        0.1,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the noise of the background and the noise "
        "expected from sky, dark current, readout and rounding. The tolerance for chance is 4 sigma.",
    )
    level_off_max: float | None = Field(
        0.01,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the background and the sky plus dark "
        "current, of the frame and of each channel. The flux of faint objects and wings, and 4 sigma of chance, are "
        "tolerated.",
    )
    uneven_max: float | None = Field(
        0.0035,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the background of a channel and that of "
        "all channels, each divided by sky plus dark current. The flux of wings and 4 sigma of chance are tolerated.",
    )
    read_noise_max: float | None = Field(
        0.05,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the read noise in a channel's overscan and "
        "the camera's. The tolerance for chance is 4 sigma.",
    )
    bias_max: float | None = Field(
        0.5,
        gt=0,
        description="DN, above 0. Maximum difference between the bias in a channel's overscan and in the header. The "
        "tolerance for chance is 4 sigma.",
    )
    header_max: float | None = Field(
        1e-4,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between gain, exposure time and read noise in the "
        "header and in the campaign.",
    )
    spectra_flux_max: float | None = Field(
        0.01,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between extracted and true electrons: the mean of "
        "the stars of a slitless exposure with spectra of S/N above 50. The tolerance for chance is 4 sigma.",
    )
    spectra_sky_max: float | None = Field(
        0.03,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the median sky next to spectra and the "
        "campaign's sky. Light of faint objects is allowed in addition.",
    )
    pointing_max: float | None = Field(
        0.01,
        gt=0,
        description="arcsec, above 0. Maximum difference of the header's pointing keywords and world coordinates from "
        "the campaign's.",
    )
    counts_max: float | None = Field(
        0.1,
        gt=0,
        description="Fraction, above 0. Maximum of |measured / true number - 1| of isolated objects brighter than S/N "
        "20 in one exposure. False sources count as measured. The tolerance for chance is 2 sigma. For a catalogue of "
        "your own the default is null.",
    )
    lost_max: float | None = Field(
        0.02,
        gt=0,
        description="Fraction, above 0. Maximum fraction of isolated objects without a merged source, of those "
        "detected in an exposure at S/N above 20. The tolerance for chance is 2 sigma. For a catalogue of your own the "
        "default is null.",
    )
    twice_max: float | None = Field(
        0.02,
        gt=0,
        description="Fraction, above 0. Maximum number of duplicate merged sources per isolated true object. The "
        "tolerance for chance is 2 sigma. For a catalogue of your own the default is null.",
    )
    psf_size_max: float | None = Field(
        0.005,
        gt=0,
        description="Fraction, above 0. Maximum relative difference between the sizes of stars and of the PSF model: "
        "the median of an exposure's stars at S/N above 50. The tolerance for chance is 4 sigma.",
    )
    psf_e_max: float | None = Field(
        0.005,
        gt=0,
        description="Ellipticity, above 0. Maximum difference between the ellipticities (distortions e1, e2) of stars "
        "and of the PSF model: the median of stars at S/N above 50. The tolerance for chance is 4 sigma.",
    )
    shape_max: float | None = Field(
        0.25,
        gt=0,
        description="Fraction, above 0. Maximum of |slope - 1|, where slope is the complex slope of measured against "
        "true galaxy shapes at S/N above 20. It detects rotations and wrong signs. The tolerance for chance is 4 "
        "sigma.",
    )
    shear_m_max: float | None = Field(
        0.05,
        gt=0,
        description="Above 0. Maximum absolute multiplicative shear bias m of `csstsim shear`. The tolerance for "
        "chance is 5 sigma.",
    )
    shear_c_max: float | None = Field(
        2e-3,
        gt=0,
        description="Above 0. Maximum absolute additive shear bias c of `csstsim shear`. The tolerance for chance is 5 "
        "sigma.",
    )

    @field_validator("pull_width")
    @classmethod
    def _rising(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not 0 <= value[0] < value[1]:
            raise ValueError("must be two numbers, the smaller first")
        return value
