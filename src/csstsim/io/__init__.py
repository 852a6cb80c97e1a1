"""Every product's file: its path, its columns and headers, reading and writing."""
