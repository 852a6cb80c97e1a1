"""`csstsim verify`: checks that a campaign's output folder is complete and sound, and writes its manifest."""
