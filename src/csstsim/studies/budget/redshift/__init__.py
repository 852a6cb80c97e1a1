"""Redshifts of a slitless survey: spectra stacked, fitted redshifts scored, biases of emission lines."""
