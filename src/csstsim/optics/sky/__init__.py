"""Background light: zodiacal light, earthshine, and stray light of sources outside the field."""
