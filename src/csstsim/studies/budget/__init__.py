"""Budgets: what each effect of sky, telescope, detector and analysis costs a measurement."""
