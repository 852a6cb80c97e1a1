"""Stars of the embedded universe."""
