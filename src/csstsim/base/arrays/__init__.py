"""Small calculations on arrays that several parts of the simulator share."""
