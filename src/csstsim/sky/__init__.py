"""Light that is no object's: zodiacal light, earthshine, and what comes in beside the mirror."""
