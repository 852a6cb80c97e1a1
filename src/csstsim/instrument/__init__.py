"""The Survey Camera as the data files in config/instrument describe it: frozen objects and simple geometry.

May import: base.
"""
