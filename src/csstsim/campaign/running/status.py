"""Progress of a campaign, from its existing products (`csstsim status`), also while it runs.

Only files are read, so it works for Snakemake on this machine or on a cluster, and for jobs run by hand. Each folder is
read once. The pace is the estimated CPU time (csstsim.campaign.costs) of recent products divided by the time they took.
The time left is the estimated CPU time of the missing products divided by the pace. Times are those of the files. Only
differences are used, because the clock of the file system may be wrong.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice
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

PACE_WINDOW = 3600.0  # s before the last product; longer if jobs take hours
PAUSE = 900.0  # s without a product: the pace is that of the work after the last pause
MAX_LOGS = 5000  # newest logs that are read
TAIL = 4096  # bytes read at the end of each log
MAX_FAILURES = 5  # listed
CRASH = "Traceback (most recent call last)"

Files = tuple[str, ...]  # paths of a product's files


@dataclass(frozen=True)
class KindProgress:
    """Products of one kind: the expected cost of each, and the times at which the existing ones were written.

    A product exists if all of its files do.
    """

    name: str
    wanted: dict[Files, float]  # {paths: CPU s}
    made: dict[Files, float]  # {paths: s since 1970}

    @property
    def missing_cpu(self) -> float:
        """Expected CPU time [s] of the missing products."""
        return sum(cpu for files, cpu in self.wanted.items() if files not in self.made)


@dataclass(frozen=True)
class Pace:
    """Recent products: those after the first one, up to the last."""

    span: float  # s, from the first to the last
    cpu: float  # expected CPU time [s]
    counts: dict[str, int]  # {kind: products}
    last: float  # time of the last product, s since 1970


@dataclass(frozen=True)
class Status:
    """Progress of a campaign."""

    kinds: list[KindProgress]
    pace: Pace | None  # None: too few products
    disk: int  # bytes in the output folder without logs
    failed: list[tuple[str, str]]  # (path of the log, its line), newest first
    missing: dict[tuple[str, int], str] = field(default_factory=dict)  # {(obsid, chip): reason} of select.missing

    @property
    def missing_cpu(self) -> float:
        """Expected CPU time [s] of the missing products of all kinds."""
        return sum(kind.missing_cpu for kind in self.kinds)

    @property
    def done(self) -> bool:
        """Whether every product exists."""
        return all(len(kind.made) == len(kind.wanted) for kind in self.kinds)

    @property
    def left(self) -> float | None:
        """Time left [s] at the pace; None if the pace is not known."""
        return None if self.pace is None else self.missing_cpu * self.pace.span / self.pace.cpu


def wanted(run: OpenCampaign) -> dict[str, dict[Files, float]]:
    """Return {kind: {paths: CPU s}} of the products of a campaign.opened.OpenCampaign, in the order of the workflow.

    The products of its variants follow, as "variant: kind".
    """
    costs = expected(run)

    def cpu(kind: ProductKind, unit: Any) -> float:
        key = getattr(unit, "key", unit)
        return sum(costs[rule][key].cpu_s for rule in kind.rules if key in costs.get(rule, ()))

    products = {
        kind.name: {tuple(map(str, kind.files_of(unit))): cpu(kind, unit) for unit in kind.made_for}
        for kind in kinds(run).values()
        if kind.made_for
    }
    variants = {f"{one.variant}: {name}": costs for one in run.variants for name, costs in wanted(one).items()}
    return products | variants


def read_status(run: OpenCampaign, products: Mapping[str, dict[Files, float]]) -> Status:
    """Return the present Status of a campaign. products: as `wanted` returned them; run: opened.OpenCampaign."""
    root = str(run.paths.output)
    found = _files(root, skip={"logs", ".snakemake"}, links=True)
    files = {path.removeprefix("./"): stat for path, stat in found}  # for the output folder `.`
    kinds = [
        KindProgress(name, costs, {key: files[key[0]].st_mtime for key in costs if all(path in files for path in key)})
        for name, costs in products.items()
    ]
    roots = (run.paths.output, *(one.paths.output for one in run.variants))
    size = sum(stat.st_size for path, stat in files.items() if "/logs/" not in path[len(root) :])
    failed = failures(*(f"{folder}/logs" for folder in roots))
    return Status(kinds, pace(kinds), size, failed, run.declared_missing)


def _files(folder: str, skip: Container[str] = (), links: bool = False) -> Iterator[tuple[str, os.stat_result]]:
    """Yield (path, stat) of the files below a folder, without those that cannot be read or are being removed.

    links: follow links to folders directly in it (products on another disk), but not in its subfolders.
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


def pace(kinds: Sequence[KindProgress]) -> Pace | None:
    """Return the Pace of the last hour of work since its last pause; None if no hour has two products.

    The hour ends with the last product, so a wrong clock or a night since then does not matter. If work has just
    started again, or a file has a date in the future, the pace is that of the work before.
    """
    made = sorted((moment, kind.name, kind.wanted[files]) for kind in kinds for files, moment in kind.made.items())
    times = [moment for moment, _, _ in made]
    longest = max((cpu for kind in kinds for cpu in kind.wanted.values()), default=0.0)
    end = len(made)
    while end > 1:
        first = end - 1
        while first and times[first] - times[first - 1] <= PAUSE + 2 * longest:
            first -= 1
        start = next(i for i in range(first, end) if times[end - 1] - times[i] <= PACE_WINDOW + 4 * longest)
        recent = made[start + 1 : end]
        span = times[end - 1] - times[start]
        if span > 0 and (cpu := sum(cost for *_, cost in recent)) > 0:
            counts = {kind.name: sum(name == kind.name for _, name, _ in recent) for kind in kinds}
            return Pace(span, cpu, counts, times[-1])
        end = first
    return None


def failures(*folders: str) -> list[tuple[str, str]]:
    """Return [(path, line)] of the newest logs with an error in folders of logs, newest first."""
    logs = sorted((file for folder in folders for file in _files(folder)), key=lambda file: -file[1].st_mtime)
    failed = ((path, line) for path, _ in logs[:MAX_LOGS] if (line := _error_line(path)))
    return list(islice(failed, MAX_FAILURES))


def _error_line(path: str) -> str | None:
    """Return the line of a log with the reason why its job failed, or None."""
    try:
        with open(path, "rb") as file:
            head = file.readline(TAIL)
            file.seek(max(os.fstat(file.fileno()).st_size - TAIL, len(head)))
            text = (head + file.read(TAIL)).decode(errors="replace")
    except OSError:
        return None
    lines = [line for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith(ERROR)]
    reason = errors[-1] if errors else lines[-1] if CRASH in text else None
    if reason is None and (pid := killed(text)):
        reason = f"killed: process {pid} ended without a message"
    return reason and "".join(c if c.isprintable() else "?" for c in reason)


def lines(status: Status, root: PathLike, now: float | None = None) -> list[str]:
    """Return the status as lines of text: kinds, time left, disk, failures. root: the output folder."""
    return [*(_kind_line(status, kind) for kind in status.kinds), *summary(status, root, now)]


def _kind_line(status: Status, kind: KindProgress) -> str:
    parts = f"{kind.name}: {len(kind.made):,} of {len(kind.wanted):,}", rate(status, kind)
    return ", ".join(part for part in parts if part)


def rate(status: Status, kind: KindProgress) -> str:
    """Return the number of products of a kind per hour as text; "" if none are recent, or if the kind is complete."""
    pace = status.pace
    count = pace.counts[kind.name] if pace else 0
    return f"{count / pace.span * 3600:,.3g} an hour" if pace and count and len(kind.made) < len(kind.wanted) else ""


def summary(status: Status, root: PathLike, now: float | None = None) -> list[str]:
    """Return the lines that concern all kinds: time left, disk, idle time, failures."""
    now = time.time() if now is None else now
    text = [f"{root}: {status.disk / 1e9:.3g} GB"]
    if status.done:
        text.append("all products exist")
    elif status.pace is None:
        text.append(f"{duration(status.missing_cpu)} of CPU time left, estimated; the remaining time is not known yet")
    else:
        left = status.left
        assert left is not None  # there is a pace
        last = datetime.fromtimestamp(status.pace.last, UTC)
        idle = now - status.pace.last
        text.append(
            f"{duration(status.missing_cpu)} of CPU time left, estimated; {duration(left)} at the pace of the last "
            f"{duration(status.pace.span)} of work"
        )
        if idle > PAUSE:
            text.append(f"no new product for {duration(idle)}: since {last:%Y-%m-%d %H:%M} UTC")
    text += [f"declared missing: {obsid} chip {chip}: {reason}" for (obsid, chip), reason in status.missing.items()]
    return text + [f"failed: {path}: {line}" for path, line in status.failed if not status.done]


def show(run: OpenCampaign, watch: float | None, log: Callable[[str], object]) -> None:
    """Print the status, with bars on a terminal; with `watch`, every so many seconds until all products exist."""
    products = wanted(run)
    root = run.paths.output
    if sys.stdout.isatty():
        from rich.live import Live

        with Live(auto_refresh=False, vertical_overflow="visible") as live:
            for status in _repeat(run, products, watch):
                live.update(_bars(status, root), refresh=True)
    else:
        for status in _repeat(run, products, watch):
            log("\n".join(lines(status, root)))


def _repeat(run: OpenCampaign, products: Mapping[str, dict[Files, float]], watch: float | None) -> Iterator[Status]:
    """Yield the Status now and, if `watch` is given, every so many seconds until all products exist."""
    while True:
        status = read_status(run, products)
        yield status
        if watch is None or status.done:
            return
        time.sleep(watch)


def _bars(status: Status, root: PathLike) -> Group:
    """Return a rich table of the kinds, with bars, and the other lines below."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for kind in status.kinds:
        made = len(kind.made)
        total = len(kind.wanted)
        table.add_row(kind.name, ProgressBar(total, made, width=30), f"{made:,} of {total:,}", rate(status, kind))
    return Group(table, *(Text(line) for line in summary(status, root)))
