"""A pack of the finished campaign, made twice."""

import pytest
from support.commands import done


@pytest.fixture(scope="session")
def packs(sound, tmp_path_factory):
    """The folders of two packs of one campaign; nothing is to be changed in them."""
    folders = [tmp_path_factory.mktemp("packs") / name for name in ("first", "second")]
    for folder in folders:
        done("release", "pack", sound[0], "--output", folder, "--author", "A. N. Other")
    return folders
