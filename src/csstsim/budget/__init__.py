"""Budgets: what each effect costs a measurement."""
