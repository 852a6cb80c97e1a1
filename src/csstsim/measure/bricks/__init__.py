"""From measured frames to bricks of the sky: merging, validation, shear."""
