"""What Snakemake says on the terminal while a campaign runs: a line for each finished job, a bar, and what failed.

Snakemake finds the module by its name (`logger: csstsim` in profiles/default). Its own, full log is in .snakemake/log.
Dry runs, and `--verbose`, are shown as Snakemake shows them.
"""

from __future__ import annotations

import logging
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from snakemake.logging import DefaultFilter, DefaultFormatter, get_event
from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent

if TYPE_CHECKING:
    from typing import Any

BAR = 24  # characters
TARGETS = "all", "everything"  # rules that only ask for the products of others
PICTURES = {"look": "a first picture"}  # rules whose file is named when it is done
TAIL = 8  # lines of a failed job's log
ERASE = "\r\033[K"
# Before the jobs begin: what a user of a campaign need not know
HIDDEN = (
    "Assuming unrestricted shared filesystem",
    "Building DAG",
    "Using shell",
    "Group jobs",
    "Conda environments",
    "Singularity containers",
    "host:",
    "Using workflow specific profile",
    "Using profile",
)
# Of errors: what the lines of failed jobs say
SAID = "Exiting because a job execution failed", "At least one job did not complete successfully"
# How a csstsim command ends on Ctrl-C, by its log (click), and on SIGINT and SIGTERM, by its exit code
ABORTED = "Aborted!"
STOPPED = re.compile(r"exit status (130|143)\b")


class LogHandler(LogHandlerBase):
    """Writes to standard error."""

    def __post_init__(self) -> None:
        settings = self.common_settings
        self._plain = settings.dryrun or settings.verbose or settings.printshellcmds
        self._formatter = DefaultFormatter(settings.quiet, settings.show_failed_logs)
        self._filter = DefaultFilter(
            settings.quiet, settings.debug_dag, settings.verbose, settings.dryrun, settings.printshellcmds
        )
        self._jobs: dict[int, str] = {}
        self._starts: dict[int, float] = {}
        self._ended: list[int] = []
        self._first = time.monotonic()
        self._all = 0
        self._bar = not self._plain and sys.stderr.isatty()
        self._begun = False
        self._held = ""

    writes_to_stream = property(lambda self: True)
    writes_to_file = property(lambda self: False)
    has_filter = property(lambda self: True)
    has_formatter = property(lambda self: True)
    needs_rulegraph = property(lambda self: False)

    def emit(self, record: logging.LogRecord) -> None:
        """Write what a record says, if it is for the user."""
        try:
            if self._filter.filter(record):
                text = self._formatter.format(record) if self._plain else self._text(record)
                if text:
                    sys.stderr.write(f"{ERASE if self._bar else ''}{text}\n")
                told: Any = record  # Snakemake's have more attributes, by event
                if self._bar and get_event(record) == LogEvent.PROGRESS:
                    total = told.total - self._all
                    sys.stderr.write(self._bar_of(told.done, total) if told.done < total else ERASE)
                sys.stderr.flush()
        except Exception:  # a log must not end a campaign
            self.handleError(record)

    def _text(self, record: Any) -> str:
        event = get_event(record)
        told = {
            LogEvent.RUN_INFO: self._run,
            LogEvent.JOB_INFO: self._know,
            LogEvent.JOB_STARTED: self._start,
            LogEvent.JOB_FINISHED: self._end,
            LogEvent.PROGRESS: self._progress,
        }
        if event == LogEvent.JOB_ERROR:
            return self._failed(record)
        if event in told:
            text = told[event](record)
        else:
            text = self._message(record) if event in (None, LogEvent.ERROR) else ""
            if text.startswith("RuleException"):  # the job's own record follows
                text, self._held = self._held, text
                return text
        text = "\n".join(filter(None, (self._held, text)))
        self._held = ""
        return text

    def _message(self, record: Any) -> str:
        """Return a message of Snakemake's if it is for the user: all but what goes without saying while jobs run."""
        text = str(self._formatter.format(record) or "").strip()
        if get_event(record) is None and record.levelno <= logging.INFO:
            return "" if self._begun or text in ("", "None") or text.startswith(HIDDEN) else text
        return "" if any(said in text for said in SAID) else text

    def _run(self, record: Any) -> str:
        self._begun = True
        rules = {rule: n for rule, n in record.stats.items() if rule not in (*TARGETS, "total")}
        self._all = sum(record.stats.get(rule, 0) for rule in TARGETS)
        total = sum(rules.values())
        return f"{total} job{'s' * (total != 1)}: " + ", ".join(f"{n} {rule}" for rule, n in rules.items())

    def _know(self, record: Any) -> None:
        places = {"obsid": "", "chip": "chip ", "pix": "brick ", "dir": None, "name": None}
        where = [
            f"{places.get(name, name + ' ')}{value}"
            for name, value in dict(record.wildcards or {}).items()
            if places.get(name, "") is not None
        ]
        self._jobs[record.jobid] = " ".join([record.rule_name, *where])
        if record.rule_name in PICTURES and getattr(record, "output", None):
            self._jobs[record.jobid] = f"{PICTURES[record.rule_name]}: {record.output[0]}"

    def _start(self, record: Any) -> None:
        for job in record.jobs if hasattr(record, "jobs") else [record.jobid]:
            self._starts[job] = time.monotonic()

    def _end(self, record: Any) -> None:
        self._ended.append(record.job_id)

    def _progress(self, record: Any) -> str:
        """Return the lines of the jobs that have ended since the last time."""
        ended = self._ended
        self._ended = []
        total = record.total - self._all
        return "\n".join(
            f"{record.done:{len(str(total))}}/{total}  {self._jobs[job]}{self._took(job)}"
            for job in ended
            if self._jobs.get(job, "all") not in TARGETS
        )

    def _took(self, job: int) -> str:
        return f"  {time.monotonic() - self._starts[job]:.1f} s" if job in self._starts else ""

    def _bar_of(self, done: int, total: int) -> str:
        spent = time.monotonic() - self._first
        full = BAR * done // total
        left = f", {spent / done * (total - done):.0f} s to go" if done else ""
        return f"[{'#' * full}{'.' * (BAR - full)}] {100 * done // total}%, {spent:.0f} s{left}"

    def _failed(self, record: Any) -> str:
        name = self._jobs.get(record.jobid, record.rule_name)
        held = self._held
        self._held = ""
        logs = [Path(log) for log in record.log or () if Path(log).is_file()]
        lines = [line for log in logs for line in log.read_text(errors="replace").splitlines()[-TAIL:]]
        if STOPPED.search(held) or [line for line in lines if line.strip()][-1:] == [ABORTED]:
            return f"interrupted {name}"
        errors = [line for line in lines if line.startswith("csstsim: error:")]
        told = [f"FAILED {name}", *(f"  {line}" for line in errors or lines), *(f"  log: {log}" for log in logs)]
        return "\n".join([held, *told] if held and not errors else told)
