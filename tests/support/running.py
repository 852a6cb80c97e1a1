"""Waiting for a process of the workflow."""

import time

import psutil


def running(verb, head, campaign, seconds=240):
    """Return the running `csstsim VERB` process of a campaign, wherever it runs; `head` must live."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and head.poll() is None:
        for process in psutil.process_iter(["cmdline"]):
            words = process.info["cmdline"] or []
            if verb in words and str(campaign) in words:
                return process
        time.sleep(0.02)
    raise AssertionError(f"no csstsim {verb} was started")
