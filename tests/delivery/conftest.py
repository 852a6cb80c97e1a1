"""Copies of the finished campaign to damage."""

import shutil

import pytest


@pytest.fixture
def copied(sound, tmp_path):
    """(campaign file, a copy of its output folder)."""
    return sound[0], shutil.copytree(sound[1], tmp_path / "a copy")
