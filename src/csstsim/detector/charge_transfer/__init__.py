"""Charge transfer inefficiency: traps, and what they do to packets of charge."""
