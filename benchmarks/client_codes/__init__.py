"""Programs that none of us wrote, on the mock's frames: the parts of benchmarks/clients.py."""
