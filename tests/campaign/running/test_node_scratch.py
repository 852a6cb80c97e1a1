"""The folder on a node's own disk."""

import os

import pytest

from csstsim.base.errors import InputError
from csstsim.campaign.running.node_scratch import node_scratch


def test_a_job_has_its_own_folder_below_the_named_one(tmp_path, monkeypatch):
    monkeypatch.setenv("DISK", str(tmp_path))
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    assert node_scratch("$DISK/a", on_node=False) == f"{tmp_path}/a/csstsim_17"
    monkeypatch.delenv("SLURM_JOB_ID")
    assert node_scratch("$DISK", on_node=True) == f"{tmp_path}/csstsim_head"


def test_a_node_without_the_folder_says_which(tmp_path):
    with pytest.raises(InputError, match=f"--config scratch: no such folder on {os.uname().nodename}"):
        node_scratch(tmp_path / "missing", on_node=True)
