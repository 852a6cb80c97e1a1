"""A package, because benchmarks/release.py has this name too."""
