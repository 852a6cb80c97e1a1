"""Places of objects: from the catalogue to the direction the spacecraft sees, and back."""
