"""Every product's file: its path, its columns and headers, reading and writing.

May import: optics, catalog, universe, instrument, detector, base.
"""
