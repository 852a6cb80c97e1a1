"""A full disk (a small tmpfs), and an output folder that cannot be written (a bind mount)."""

import os
import shutil
import subprocess
from contextlib import contextmanager

import pytest

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("mount"), reason="only root can mount a small disk"),
]
# Left on the disk, in turn: too little for the rule, enough for those before it (a PSF set with its tables is 8460)
FREE_KB = {"psf": 1000, "render": 8500, "report": 330}


def mount(*words):
    subprocess.run(["mount", *map(str, words)], check=True, timeout=60)


@contextmanager
def mounted(place, *words):
    """Mount something on `place`, as in `mount WORDS PLACE`, for a while."""
    mount(*words, place)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True, timeout=60)


def used_kb(place):
    disk = os.statvfs(place)
    return (disk.f_blocks - disk.f_bfree) * disk.f_frsize // 1024


def test_disk_full(small_run, tell):
    small_run.back_before("psf")
    out, aside = small_run.out, small_run.folder / "aside"
    shutil.copytree(out, aside)
    with mounted(out, "-t", "tmpfs", "-o", "size=20m", "tmpfs"):
        shutil.copytree(aside, out, dirs_exist_ok=True)
        for rule, free in FREE_KB.items():
            mount("-o", f"remount,size={used_kb(out) + free}k", out)
            small_run.refused(f"FAILED {rule}", "cannot be written: No space left on device")
            small_run.assert_nothing_wrong()
            assert small_run.temporaries() == []
        mount("-o", "remount,size=20m", out)
        small_run.resume()
        small_run.assert_as_undisturbed()
    happened = "the file and the reason in one line, no half file; with room the same command goes on"
    tell("disk full", ", ".join(FREE_KB), happened)


@pytest.mark.parametrize("folder", ["", "measure"])
def test_output_is_read_only(small_run, tell, folder):
    small_run.back_before("measure")
    place = small_run.out / folder
    place.mkdir(exist_ok=True)
    with mounted(place, "--bind", place):
        mount("-o", "remount,bind,ro", place)
        small_run.refused(str(place), "cannot be written")
        small_run.assert_nothing_wrong()
    small_run.resume()
    small_run.assert_as_undisturbed()
    what = f"{folder}/ in the output folder" if folder else "output folder"
    tell(f"{what} read-only", "before measure", "refused in one line with its name")
