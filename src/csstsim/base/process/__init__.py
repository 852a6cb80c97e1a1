"""What concerns the process: threads, compiled code, progress."""
