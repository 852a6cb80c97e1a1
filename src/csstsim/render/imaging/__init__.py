"""Objects drawn on an imaging chip."""
