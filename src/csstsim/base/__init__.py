"""The base of csstsim: errors, units, random streams, threads, typed models. It imports no other part."""
