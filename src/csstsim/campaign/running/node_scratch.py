"""The folder of a cluster job on its node's own disk, which `--config scratch=...` names."""

import os
from pathlib import Path

from csstsim.base.errors import InputError


def node_scratch(folder: object, *, on_node: bool) -> str:
    """Return the subfolder of this job in a folder, whose name may contain environment variables.

    on_node: whether this process runs on a node. The process that starts the jobs does not need the folder, because it
    reads no intermediate file. Raises InputError for a folder that the node does not have.
    """
    disk = Path(os.path.expandvars(str(folder)))  # str: YAML may give any type
    if on_node and not disk.is_dir():
        raise InputError(f"no such folder on {os.uname().nodename}", key="--config scratch", value=folder)
    return str(disk / f"csstsim_{os.environ.get('SLURM_JOB_ID', 'head')}")
