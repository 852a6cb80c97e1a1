"""Charge transfer inefficiency: traps and their effect on packets of charge."""
