"""A release that others can cite and use: its RO-Crate metadata, a small public benchmark, and catalogues scored."""
