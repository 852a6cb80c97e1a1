"""The largest private memory of a process."""

import threading
from pathlib import Path


class PrivateMemory(threading.Thread):
    """Context manager that records a process's largest anonymous memory [GB], which no file or process shares."""

    def __init__(self, pid="self"):
        super().__init__(daemon=True)
        self.status, self.largest, self._end = Path(f"/proc/{pid}/status"), 0.0, threading.Event()

    def run(self):
        """Read the process's memory every 20 ms until the context ends."""
        while not self._end.wait(0.02):
            try:
                lines = self.status.read_text().splitlines()
            except OSError:  # it has ended
                return
            self.largest = max(
                [self.largest, *(int(line.split()[1]) / 1e6 for line in lines if line.startswith("RssAnon"))]
            )

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self.join()
