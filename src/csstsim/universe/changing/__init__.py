"""What changes on the embedded sky: variable stars and quasars, asteroids, satellites."""
