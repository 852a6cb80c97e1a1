"""Kernels of the detector: functions of arrays, independent of the rest of the simulator.

May import: base.
"""
