"""Objects rendered on an imaging chip."""
