"""How many coefficients the spectrum of a galaxy or quasar has: on components, of the columns coeff0, coeff1, ..."""

COEFFICIENTS = 20
