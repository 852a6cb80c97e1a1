"""Code that several stages use, and the sections of the report."""
