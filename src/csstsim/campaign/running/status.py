"""Progress of a campaign, from the files it has made so far (`csstsim status`), also while it runs.

Only files are read, so it works the same for Snakemake here, on a cluster, and for jobs run by hand. Each folder is
read once. The pace is the estimated CPU time (csstsim.campaign.costs) of recent products over the time they took; the
time left is the CPU time of the missing products over the pace. Times are those of the files. Their disk's clock may be
wrong: only differences count.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from csstsim.campaign.costs import expected
from csstsim.campaign.plan import duration
from csstsim.campaign.products import kinds
from csstsim.campaign.running.job_log import ERROR, killed

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Mapping, Sequence
    from typing import Any

    from rich.console import Group

    from csstsim.base.types import PathLike
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.products import ProductKind

# s: the pace is that of the last hour, after the last pause; jobs of hours look further
LATELY = 3600.0
PAUSE = 900.0
# newest logs looked into, bytes of each, failures named
LOGS = 5000
TAIL = 4096
FAILURES = 5
CRASH = "Traceback (most recent call last)"


@dataclass(frozen=True)
class Kind:
    """Products of one kind: the expected cost of each, and when the existing ones were made."""

    name: str
    wanted: dict[str, float]  # {path: CPU s}
    made: dict[str, float]  # {path: s since 1970}

    @property
    def missing_cpu(self) -> float:
        """Expected CPU seconds of the missing products."""
        return sum(cpu for path, cpu in self.wanted.items() if path not in self.made)


@dataclass(frozen=True)
class Pace:
    """Recent products: from the first of them, which is not counted, to the last."""

    span: float  # s
    cpu: float  # CPU s expected of them
    counts: dict[str, int]  # {kind: products}
    last: float  # s since 1970


@dataclass(frozen=True)
class Status:
    """Progress of a campaign."""

    kinds: list[Kind]
    pace: Pace | None  # None: too little was made to tell
    disk: int  # bytes in the output folder, logs left out
    failed: list[tuple[str, str]]  # (path of the log, its line), newest first
    # {(obsid, chip): reason}, declared in the campaign
    missing: dict[tuple[str, int], str] = field(default_factory=dict)

    @property
    def missing_cpu(self) -> float:
        """Expected CPU seconds of the missing products of all kinds."""
        return sum(kind.missing_cpu for kind in self.kinds)

    @property
    def done(self) -> bool:
        """Whether every product exists."""
        return all(len(kind.made) == len(kind.wanted) for kind in self.kinds)

    @property
    def left(self) -> float | None:
        """Seconds left at the pace, None if that is not known."""
        return None if self.pace is None else self.missing_cpu * self.pace.span / self.pace.cpu


def wanted(run: OpenCampaign) -> dict[str, dict[str, float]]:
    """Return {kind: {path: CPU s}} of the products of a campaign.opened.OpenCampaign, in the order of the workflow.

    Those of its variants follow, as "variant: kind".
    """
    costs = expected(run)

    def cpu(kind: ProductKind, one: Any) -> float:
        key = getattr(one, "key", one)
        return sum(costs[rule][key].cpu_s for rule in kind.rules if key in costs.get(rule, ()))

    own = {
        kind.name: {str(kind.files_of(one)[0]): cpu(kind, one) for one in kind.made_for}
        for kind in kinds(run).values()
        if kind.made_for
    }
    variants = {f"{one.variant}: {name}": paths for one in run.variants for name, paths in wanted(one).items()}
    return own | variants


def look(run: OpenCampaign, products: Mapping[str, dict[str, float]]) -> Status:
    """Return the Status of a campaign now. products: what `wanted` returned; run: campaign.opened.OpenCampaign."""
    root = str(run.paths.output)
    found = _files(root, skip={"logs", ".snakemake"}, links=True)
    files = {path.removeprefix("./"): about for path, about in found}  # of the folder `.`
    kinds = [
        Kind(name, paths, {path: files[path].st_mtime for path in paths if path in files})
        for name, paths in products.items()
    ]
    roots = (run.paths.output, *(one.paths.output for one in run.variants))
    size = sum(about.st_size for path, about in files.items() if "/logs/" not in path[len(root) :])
    failed = failures(*(f"{folder}/logs" for folder in roots))
    return Status(kinds, pace(kinds), size, failed, run.declared_missing)


def _files(folder: str, skip: Container[str] = (), links: bool = False) -> Iterator[tuple[str, os.stat_result]]:
    """Yield (path, stat) of the files below a folder, except those that cannot be read or vanish meanwhile.

    links: follow links to folders directly in it (products on another disk), but not further down.
    """
    try:
        entries = list(os.scandir(folder))
    except OSError:
        return
    for entry in entries:
        try:
            if entry.is_dir(follow_symlinks=links):
                if entry.name not in skip:
                    yield from _files(entry.path)
            elif entry.is_file():
                yield entry.path, entry.stat()
        except OSError:
            continue


def pace(kinds: Sequence[Kind]) -> Pace | None:
    """Return the Pace of the last hour of work since its last pause; None if no hour has two products.

    The hour ends with the last product, so a wrong clock or a night since then does not matter. If work has only just
    begun again, or a file has a date in the future, the work before it gives the pace.
    """
    made = sorted((moment, kind.name, kind.wanted[path]) for kind in kinds for path, moment in kind.made.items())
    longest = max((cpu for kind in kinds for cpu in kind.wanted.values()), default=0.0)
    end = len(made)
    while end > 1:
        first = end - 1
        while first and made[first][0] - made[first - 1][0] <= PAUSE + 2 * longest:
            first -= 1
        start = next(i for i in range(first, end) if made[end - 1][0] - made[i][0] <= LATELY + 4 * longest)
        lately = made[start + 1 : end]
        span = made[end - 1][0] - made[start][0]
        if span > 0 and (cpu := sum(cost for *_, cost in lately)) > 0:
            counts = {kind.name: sum(name == kind.name for _, name, _ in lately) for kind in kinds}
            return Pace(span, cpu, counts, made[-1][0])
        end = first
    return None


def failures(*folders: str) -> list[tuple[str, str]]:
    """Return [(path, line)] of the newest logs with an error in folders of logs, newest first."""
    logs = sorted((file for folder in folders for file in _files(folder)), key=lambda file: -file[1].st_mtime)[:LOGS]
    found = ((path, line) for path, _ in logs if (line := _complaint(path)))
    return [failure for failure, _ in zip(found, range(FAILURES), strict=False)]


def _complaint(path: str) -> str | None:
    """Return the line of a log with the reason why its job failed, or None."""
    try:
        with open(path, "rb") as file:
            head = file.readline(TAIL)
            file.seek(max(os.fstat(file.fileno()).st_size - TAIL, len(head)))
            text = (head + file.read(TAIL)).decode(errors="replace")
    except OSError:
        return None
    lines = [line for line in text.splitlines() if line.strip()]
    said = [line for line in lines if line.startswith(ERROR)]
    found = said[-1] if said else lines[-1] if CRASH in text else None
    if found is None and (pid := killed(text)):
        found = f"killed: process {pid} ended without a message"
    return found and "".join(c if c.isprintable() else "?" for c in found)


def lines(status: Status, root: PathLike, now: float | None = None) -> list[str]:
    """Return the status in words, a line each: kinds, time left, disk, failures. root: the output folder."""
    return [*(_kind_line(status, kind) for kind in status.kinds), *summary(status, root, now)]


def _kind_line(status: Status, kind: Kind) -> str:
    parts = f"{kind.name}: {len(kind.made):,} of {len(kind.wanted):,}", rate(status, kind)
    return ", ".join(part for part in parts if part)


def rate(status: Status, kind: Kind) -> str:
    """Return in words how many of a kind are made in an hour, "" if none lately."""
    pace = status.pace
    count = pace.counts[kind.name] if pace else 0
    return f"{count / pace.span * 3600:,.3g} an hour" if pace and count and len(kind.made) < len(kind.wanted) else ""


def summary(status: Status, root: PathLike, now: float | None = None) -> list[str]:
    """Return the lines that concern all kinds: time left, disk, idle time, failures."""
    now = time.time() if now is None else now
    said = [f"{root}: {status.disk / 1e9:.3g} GB"]
    if status.done:
        said.append("all is made")
    elif status.pace is None:
        said.append(f"{duration(status.missing_cpu)} of CPU time to go, estimated; the time left is not known yet")
    else:
        left = status.left
        assert left is not None  # there is a pace
        last = datetime.fromtimestamp(status.pace.last, UTC)
        idle = now - status.pace.last
        said.append(
            f"{duration(status.missing_cpu)} of CPU time to go, estimated; at the pace of the last "
            f"{duration(status.pace.span)} of work {duration(left)} left"
        )
        if idle > PAUSE:
            said.append(f"nothing was made for {duration(idle)}: since {last:%Y-%m-%d %H:%M} UTC")
    said += [f"declared missing: {obsid} chip {chip}: {reason}" for (obsid, chip), reason in status.missing.items()]
    return said + [f"failed: {path}: {line}" for path, line in status.failed if not status.done]


def show(run: OpenCampaign, watch: float | None, say: Callable[[str], object]) -> None:
    """Show the status of a campaign, with bars on a terminal; every `watch` seconds, if given, until all is made."""
    products = wanted(run)
    root = run.paths.output
    if sys.stdout.isatty():
        from rich.live import Live

        with Live(auto_refresh=False, vertical_overflow="visible") as live:
            for status in _repeat(run, products, watch):
                live.update(_picture(status, root), refresh=True)
    else:
        for status in _repeat(run, products, watch):
            say("\n".join(lines(status, root)))


def _repeat(run: OpenCampaign, products: Mapping[str, dict[str, float]], watch: float | None) -> Iterator[Status]:
    """Yield the Status now and, if `watch` is given, every so many seconds until all is made."""
    while True:
        status = look(run, products)
        yield status
        if watch is None or status.done:
            return
        time.sleep(watch)


def _picture(status: Status, root: PathLike) -> Group:
    """Return a rich table of the kinds, with bars, and the other lines below."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for kind in status.kinds:
        made = len(kind.made)
        all_ = len(kind.wanted)
        table.add_row(kind.name, ProgressBar(all_, made, width=30), f"{made:,} of {all_:,}", rate(status, kind))
    return Group(table, *(Text(line) for line in summary(status, root)))
