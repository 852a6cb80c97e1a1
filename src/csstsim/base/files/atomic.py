"""Atomic writing of files: temporary file in the same folder, fsync, rename. Readers never see incomplete files.

A process that is killed, or whose machine crashes, leaves a temporary file `.name.host.pid.tmp.suffix`, which is not
read as a product. The next process on that host that writes the same file removes it. `remove_left` removes all
temporary files at the end of a campaign.
"""

from __future__ import annotations

import errno
import glob
import os
import re
import socket
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.file_log import logged

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from csstsim.base.types import PathLike

HOST = socket.gethostname()
# Errors of the disk, as opposed to bugs
DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
_LEFT = re.compile(r"\..+\.(?P<pid>\d+)\.tmp(\.\w+)?")


@contextmanager
def atomic_path(path: PathLike) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; on success it is flushed to disk and renamed to `path`.

    On any exception the temporary file is removed and `path` is not changed. A missing parent folder is made. The
    temporary name has the suffix of `path`, which some writers need. Raises InputError if the disk is full, read-only,
    forbidden or broken.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{HOST}.{os.getpid()}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_dead(path.parent.glob(glob.escape(f".{path.stem}.{HOST}.") + f"*.tmp{path.suffix}"))
        with logged("wrote", path):
            yield temporary
            _flush(temporary)
            os.replace(temporary, path)
            _flush(path.parent)  # the rename itself
    except OSError as exc:
        if exc.errno not in DISK or Path(exc.filename or temporary) not in (temporary, *path.parents):
            raise
        raise InputError(f"cannot be written: {os.strerror(exc.errno)}", file=path) from exc
    finally:
        temporary.unlink(missing_ok=True)


def remove_left(folder: PathLike) -> int:
    """Remove the temporary files below a folder, except those of running processes of this host; return their number.

    Files of other hosts are removed without a check, so call it after the campaign's jobs have ended.
    """
    return _remove_dead(Path(folder).rglob(".*.tmp*"))


def _remove_dead(paths: Iterable[Path]) -> int:
    dead = [path for path in paths if (match := _LEFT.fullmatch(path.name)) and not _writes(path.name, match["pid"])]
    for path in dead:
        path.unlink(missing_ok=True)
    return len(dead)


def _writes(name: str, pid: str) -> bool:
    """Return whether a temporary file belongs to a running process of this host."""
    if f".{HOST}.{pid}.tmp" not in name:
        return False
    try:
        os.kill(int(pid), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # a process of another user
        return True
    return True


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
