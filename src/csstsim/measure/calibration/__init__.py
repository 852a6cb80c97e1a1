"""From a Level-0 file to a calibrated frame, and master calibration frames."""
