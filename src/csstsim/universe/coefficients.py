"""The number of coefficients of the spectrum of a galaxy or quasar, in the columns coeff0, coeff1, ..."""

COEFFICIENTS = 20
