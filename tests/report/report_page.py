"""A small campaign with its report, made by the commands; and a parser of pages."""

from html.parser import HTMLParser

import numpy as np
from support.commands import done
from support.mini_campaign import POINTINGS, write_scene

from csstsim.campaign.opened import OpenCampaign

VOID = {"meta", "img", "image", "rect", "path"}  # elements of the page without an end tag, some closed by "/>"


class Reader(HTMLParser):
    """Collects text and tags, and checks that tags close in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.tags = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def values(self, tag, key):
        return [attrs[key] for name, attrs in self.tags if name == tag and key in attrs]


def star_campaign(folder, chips=(9,), **changes):
    """Write a campaign of 25 stars on an r chip (9), run it up to the validation; return (its file, OpenCampaign)."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(12, 116, 5), np.linspace(12, 116, 5)))
    select = {"types": ["SCIE"], "chips": list(chips)}
    file = write_scene(folder, "Stars", x, y, 20.0, 9, POINTINGS[0], select=select, **changes)
    run = OpenCampaign(file)
    for job in run.jobs:
        obsid, chip = job.key
        done("chip", file, "--obsid", obsid, "--chip", chip)
        if job in run.imaging_jobs:
            done("measure", file, "--obsid", obsid, "--chip", chip)
    for pix in run.merge_bricks:
        done("merge", file, "--brick", pix)
        done("validate", file, "--brick", pix)
    return file, run
