"""Small calculations on arrays, used by several parts of the simulator."""
