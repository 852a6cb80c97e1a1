"""How much memory a process takes for itself alone."""

import threading
from pathlib import Path


class PrivateMemory(threading.Thread):
    """Watches, while it is entered, the largest anonymous memory of a process: shared with nobody and no file [GB]."""

    def __init__(self, pid="self"):
        super().__init__(daemon=True)
        self.status, self.largest, self._end = Path(f"/proc/{pid}/status"), 0.0, threading.Event()

    def run(self):
        """Look at the process every 20 ms, until told to end."""
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
