"""Which jobs, chips and bricks a campaign's rules work on, of eight jobs made up here."""

from types import SimpleNamespace

import pytest

from csstsim.campaign import job_lists
from csstsim.campaign.job_lists import JobLists

FULL = (0, 100, 0, 100)


def job(obsid, number, kind="SCIE", name="r", chip_kind="imaging", window=FULL, footprint=None):
    chip = SimpleNamespace(id=number, filter=name, kind=chip_kind, full_window=FULL)
    pointing = SimpleNamespace(type=kind)
    return SimpleNamespace(
        obsid=obsid, chip=chip, pointing=pointing, window=window, key=(obsid, number), footprint=footprint
    )


class Run(JobLists):
    """Jobs; those of spectra are the slitless ones of science exposures."""

    embedded = True
    camera = SimpleNamespace(filters=("NUV", "u", "g", "r", "i", "GI"))

    def __init__(self, *jobs):
        self.jobs = jobs

    def has_orders(self, job):
        return job.chip.kind == "slitless" and job.pointing.type == "SCIE"

    def truth_bricks(self, job):
        return {9: (30, 7), 6: (7, 30, 12), 21: (500,), 8: (3,)}.get(job.chip.id, ())


A = job("1", 9), job("1", 21, name="GI", chip_kind="slitless"), job("1", 6, name="u"), job("2", 9)
B = job("3", 9, "BIAS"), job("3", 21, "DARK", chip_kind="slitless"), job("4", 8, "FLAT")


def test_jobs_are_sorted_by_what_is_made_of_them():
    run = Run(*B, *A)
    assert run.science_jobs == A and run.imaging_jobs == (A[0], A[2], A[3]) and run.slitless_jobs == (A[1],)
    assert run.sky_chips == [6, 9, 21] and run.sky_bricks == [7, 12, 30, 500]
    assert run.science_exposures == {"1": [*A[:3]], "2": [A[3]]} and Run(*B).science_exposures == {}
    own = Run(*A)
    own.embedded = False
    assert own.sky_bricks == [] and own.sky_chips == [6, 9, 21]


@pytest.mark.parametrize(("names", "first"), [
    (("NUV",), "NUV"), (("NUV", "i"), "i"), (("i", "u", "NUV"), "u"), (("NUV", "u", "g", "r"), "g"),
])  # fmt: skip
def test_the_first_picture_is_of_the_middle_band(names, first):
    jobs = [job(str(number), number, name=name) for number, name in enumerate(names, 1)]
    slitless = job("0", 21, name="GI", chip_kind="slitless")
    frames = Run(slitless, *jobs, *jobs).first_frames
    assert isinstance(frames, tuple) and [shown.chip.filter for shown in frames] == [first]
    assert Run(slitless, *B).first_frames == (slitless,) and Run(*B).first_frames == ()


def calibrations(number, window=FULL, **counts):
    return [job(f"{kind}{k}", number, kind, window=window) for kind, count in counts.items() for k in range(count)]


def test_masters_need_three_whole_frames_of_each_kind():
    good, more = calibrations(9, BIAS=3, DARK=4, FLAT=3), calibrations(8, BIAS=5, DARK=3, FLAT=2)
    cut = calibrations(7, BIAS=3, DARK=3, FLAT=2) + calibrations(7, (0, 100, 0, 50), FLAT=4)
    run = Run(*more, *A, *good, *cut)
    assert run.calibration_jobs == {9: good}


def test_a_brick_has_the_jobs_whose_measured_window_comes_near_it(monkeypatch):
    """A margin of 3 px about the window and of 2 arcsec about the brick; bricks are sorted, jobs as they come."""
    asked = []

    def bricks_for(ra, dec, margin):
        asked.append((ra, dec, margin))
        return ra

    monkeypatch.setattr(job_lists, "bricks_for", bricks_for)
    jobs = [
        job("1", 9, footprint=lambda edge: ((30, 7), edge)), job("1", 6, footprint=lambda edge: ((7, 9), edge)),
        job("1", 21, chip_kind="slitless", footprint=lambda edge: ((1,), edge)),
        job("2", 9, footprint=lambda edge: ((7,), edge)),
    ]  # fmt: skip
    found = Run(*jobs).merge_bricks
    assert list(found.items()) == [(7, [jobs[0], jobs[1], jobs[3]]), (9, [jobs[1]]), (30, [jobs[0]])]
    assert {type(pix) for pix in found} == {int}
    assert asked == [((30, 7), 3.0, 2 / 3600), ((7, 9), 3.0, 2 / 3600), ((7,), 3.0, 2 / 3600)]
