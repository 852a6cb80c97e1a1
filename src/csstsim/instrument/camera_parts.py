"""Which stages read which numbers of a camera: a change of the gain, say, leaves the drawn light valid.

A part is a number of the files BY_NUMBER (instrument.files), as `detector.gain`, or another data file as a whole, as
`cti.yaml`. Laboratory maps (maps.chip_maps) are no parts of the camera: a map counts for the one chip that it is of.
"""

# What reads a part first (base.stages.read_by): not only select, psf and truth
READERS = {
    "detector.nx": ("psf", "select"),
    "detector.ny": ("psf", "select"),
    "detector.pixel_um": ("psf", "select"),
    "detector.dark": ("select",),  # its noise decides how objects are drawn
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
    "telescope.telescope.*": ("psf", "select"),
}
