"""Where light of a direction falls: projection, distortion, header coordinates."""
