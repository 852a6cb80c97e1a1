"""A release to cite and use: its RO-Crate metadata, a small public benchmark, and scores of catalogues."""
