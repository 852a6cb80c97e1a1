"""The stages of the workflow: one file for each rule, with the name of the rule and its command.

Each has a function that works in memory, and one that reads its input, calls it and writes the product. A stage refuses
an input that records another recipe (digests of campaign, camera, layers and exposure), and its product records the
recipe, too. A product gets its final name only when it is complete.

May import: campaign, simulation, layers, report, render, measure, io, optics, catalog, universe, instrument,
detector, base.
"""
