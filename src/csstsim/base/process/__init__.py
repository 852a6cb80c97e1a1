"""Properties of the process: threads, memory, compiled code, progress bars."""
