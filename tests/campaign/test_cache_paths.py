"""The user's cache: which folder it is, and which products of which campaigns share a place in it."""

from pathlib import Path

import pytest
from support.mini_campaign import write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.cache_paths import CachePaths, cache_folder
from csstsim.campaign.opened import OpenCampaign

OBSID = "10100000001"


def test_what_is_given_comes_before_the_environment_and_that_before_the_home(tmp_path, monkeypatch):
    """Each way in turn is taken away; the folder is made, and stays where it is if one goes elsewhere."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CSSTSIM_CACHE", str(tmp_path / "ours"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "desktop"))
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    found = [cache_folder("given"), cache_folder()]
    monkeypatch.delenv("CSSTSIM_CACHE")
    found.append(cache_folder())
    monkeypatch.delenv("XDG_CACHE_HOME")
    found.append(cache_folder())
    names = "given", "ours", "desktop/csstsim", "home/.cache/csstsim"
    assert found == [tmp_path / name for name in names] and all(folder.is_dir() for folder in found)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file/cache: cache: cannot be made: Not a directory; .*CSSTSIM_CACHE"):
        cache_folder(tmp_path / "file" / "cache")


@pytest.mark.parametrize(("changes", "another_sky", "another_psf"), [
    ({"fidelity": "preview", "measurement": {"cti_passes": 1}, "name": "b", "output": "b"}, False, False),
    ({"seed": 4}, True, False), ({"psf": {"grid": 3}}, False, True), ({"seed": 4, "psf": {"grid": 3}}, True, True),
    ({"catalog": {"structure": "field"}}, True, False),
])  # fmt: skip
def test_bricks_and_sets_are_shared_by_those_that_make_the_same(tmp_path, changes, another_sky, another_psf):
    """What a key changes is kept apart, and what it does not change is found again; all else is of no use to others."""
    paths = [CachePaths(tmp_path / "cache", OpenCampaign(write_campaign(tmp_path, **keys))) for keys in ({}, changes)]
    ours, theirs = paths
    assert (ours.truth(5) != theirs.truth(5)) is another_sky
    assert (ours.psf(9) != theirs.psf(9)) is another_psf
    for one in paths:
        assert one.psf(9).parent == one.psf_tables(9).parent and one.truth(5).parents[4] != one.psf(9).parents[1]
        assert one.truth(5).name == "Npix=5.parquet" and one.psf(9).name == "chip_09.h5"
        assert one.stage(OBSID, 9, "render.fits") == tmp_path / "cache/products/chips/10100000001_09/render.fits"
        assert all(path.is_relative_to(tmp_path / "cache") for path in (one.truth(5), one.psf(9)))
