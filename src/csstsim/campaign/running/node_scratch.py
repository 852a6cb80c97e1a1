"""The folder of a cluster job on its node's own disk, which `--config scratch=...` names."""

import os
from pathlib import Path

from csstsim.base.errors import InputError


def node_scratch(named: object, *, on_node: bool) -> str:
    """Return the folder of this job below the one that is `named`, in which environment variables are replaced.

    on_node: whether this process runs on the node. The head of the workflow need not have such a folder: it sees no
    intermediate file. Raises InputError for a folder that the node does not have.
    """
    disk = Path(os.path.expandvars(str(named)))  # a YAML file may hold anything
    if on_node and not disk.is_dir():
        raise InputError(f"no such folder on {os.uname().nodename}", key="--config scratch", value=named)
    return str(disk / f"csstsim_{os.environ.get('SLURM_JOB_ID', 'head')}")
