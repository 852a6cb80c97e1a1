"""The stages that read each parameter of a camera. For example, rendered images stay valid after a change of the gain.

A part is a parameter of the files BY_PARAMETER (instrument.files), such as `detector.gain`, or another complete data
file, such as `cti.yaml`. Laboratory maps (maps.chip_maps) are not parts, because each belongs to one chip.
"""

# {part: the stages that read it first} (base.stages.read_by), if these are not truth, psf and select
READERS = {
    "detector.nx": ("psf", "select"),
    "detector.ny": ("psf", "select"),
    "detector.pixel_um": ("psf", "select"),
    "detector.dark": ("select",),  # the method of rendering depends on its noise
    "detector.read_noise": ("select",),
    "detector.full_well": ("render",),  # which objects saturate
    "detector.prnu": ("render",),
    "detector.channel*": ("readout",),
    "detector.*scan": ("readout",),
    "detector.gain*": ("readout",),
    "detector.bias*": ("readout",),
    "detector.bloom_row_share": ("readout",),
    "detector.nonlinearity*": ("readout",),
    "detector.readout_time": ("readout",),  # cosmic rays hit during it
    "detector.adc_max": ("level0",),
    "detector.temperature": ("level0",),
    "brighter_fatter.yaml": ("readout",),
    "cosmic_rays.yaml": ("readout",),
    "cti.yaml": ("readout",),
    "defects.yaml": ("readout",),
    "level0_keywords.yaml": ("level0",),
    "chips.yaml": ("psf", "select"),
    "distortion.fits": ("select",),
    "distortion.yaml": ("psf",),
    "filters.*.limiting_mag": ("validate",),
    "filters.*.saturation_mag": ("validate",),
    "filters.*.sky": ("select",),
    "ghosts.yaml": ("psf", "select"),
    "gratings*": ("select",),
    "leds.yaml": ("render",),
    "psf.yaml": ("psf", "select"),
    "scatter.yaml": ("psf", "select"),
    "sky.yaml": ("render",),
    "telescope.orbit.*": ("select",),
    "telescope.telescope.diameter_m": ("truth", "psf", "select"),
    "telescope.telescope.shutter_*": ("render",),
    "telescope.telescope.sun_angle_min": (),  # of warnings, and of no product
    "telescope.telescope.*": ("psf", "select"),
}
