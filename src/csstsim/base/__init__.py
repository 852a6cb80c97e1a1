"""The base of csstsim: errors, units, random streams, threads, typed models.

May import no other part.
"""
