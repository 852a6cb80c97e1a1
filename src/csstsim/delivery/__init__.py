"""Is a campaign's output folder whole, and is it what it says it is? `csstsim verify`, and the manifest."""
