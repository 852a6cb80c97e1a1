"""What a slitless survey knows of redshifts: spectra stacked, answers scored, biases of lines."""
