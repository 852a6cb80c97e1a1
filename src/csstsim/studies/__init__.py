"""Studies with whole campaigns, for the command line: benchmark, budgets, comparison, recreation, releases.

May import: api, inject, delivery, stages, campaign, simulation, layers, report, render, measure, io, optics, catalog,
universe, instrument, detector, base.
"""
