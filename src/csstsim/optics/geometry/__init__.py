"""Where light from a direction falls: projection, distortion, header coordinates."""
