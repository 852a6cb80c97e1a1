"""Objects drawn into an image of electrons: which method for which object, and the methods."""
