"""Programs forked from a process that has imported the libraries: python tests/support/warm.py COMMAND...

While COMMAND runs, `csstsim`, `snakemake` and `python SCRIPT` are forks of one process, wherever they are started from.
Imports are two fifths of the CPU time of suites that start hundreds of short processes. A program sees the arguments,
folder, environment, limits and open streams that it was started with, and ends as it would. What needs a process of its
own are tests of imports and CPU times. `python -c`, `python -m` of other modules and programs with other variables for
libraries (FIXED) are started as ever.
"""

import array
import contextlib
import gc
import json
import os
import resource
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

BIN = Path(sys.executable).parent  # of the environment whose programs are forked
PROGRAMS = "csstsim", "snakemake", "python", "python3"
STAGES = (
    "truth", "psf", "select", "render", "readout", "level0", "chip", "measure", "merge", "validate", "report",
)  # fmt: skip
IMPORTED = (
    "numba", "scipy.fft", "scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.ndimage", "scipy.optimize",
    "scipy.special", "scipy.spatial", "astropy.io.fits", "astropy.wcs", "astropy.table", "astropy.units",
    "astropy.coordinates", "fitsio", "h5py", "hpgeom", "erfa", "pyarrow.parquet", "pydantic", "yaml", "click",
    "matplotlib.pyplot", "snakemake.cli", "snakemake.api", "csstsim.command_line.main", "csstsim.campaign.opened",
    *(f"csstsim.stages.{stage}" for stage in STAGES),
)  # fmt: skip
# Beginnings of variables that are read at imports. All run on one thread, so nothing is said by a 1
FIXED = "NUMBA_", "OMP_", "OPENBLAS_", "MKL_", "MPL", "PYTHONHASHSEED", "PYTHONPATH", "PYTHONWARNINGS", "LD_"
THREADS = tuple(f"{library}_NUM_THREADS" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA"))
LIMITS = resource.RLIMIT_AS, resource.RLIMIT_FSIZE, resource.RLIMIT_NOFILE, resource.RLIMIT_CORE, resource.RLIMIT_CPU
FORWARDED = signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1
# A program of the folder that goes first on the path; -I -S: it needs the standard library alone, and starts in 15 ms
STARTER = '#!/bin/sh\nexec {python} -I -S {here} --program {socket} {name} "$@"\n'


def _fixed() -> dict[str, str]:
    """Return the variables that libraries read when they are imported."""
    fixed = {name: value for name, value in os.environ.items() if name.startswith(FIXED)}
    return {name: value for name, value in fixed.items() if name not in THREADS or value != "1"}


def _script(name: str, words: list[str]) -> tuple[Path, list[str]] | None:
    """Return the file that a program executes and its arguments; None if it is not one to be forked."""
    match name, words:
        case "python" | "python3", ["-m", "snakemake", *rest]:
            return BIN / "snakemake", rest
        case "python" | "python3", [script, *rest] if not script.startswith("-"):
            return Path(script), rest
        case "python" | "python3", _:
            return None
    return BIN / name, words


def start(address: str, name: str, words: list[str]) -> int:
    """Be one program: have it forked, pass signals on, and return its exit code (or end by its signal)."""
    if words and Path(words[0]).parent == Path(address).with_name("bin"):  # python with one of these programs
        words[0] = str(BIN / Path(words[0]).name)
    script = _script(name, words)
    connection = socket.socket(socket.AF_UNIX)
    if script is not None:
        with contextlib.suppress(OSError):
            connection.connect(address)
            wanted = {
                "script": str(script[0]), "words": script[1], "folder": os.getcwd(), "environment": dict(os.environ),
                "fixed": _fixed(), "group": os.getpgrp(), "umask": _umask(), "nice": os.nice(0),
                "limits": [resource.getrlimit(limit) for limit in LIMITS],
            }  # fmt: skip
            streams = array.array("i", [0, 1, 2]).tobytes()
            connection.sendmsg([b"."], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, streams)])
            connection.sendall(json.dumps(wanted).encode() + b"\n")
            answers = connection.makefile("r")
            if child := int(answers.readline() or 0):
                for number in FORWARDED:
                    signal.signal(number, lambda got, _: os.kill(child, got))
                code = int(answers.readline() or 1)
                if code < 0:
                    signal.signal(-code, signal.SIG_DFL) if -code != signal.SIGKILL else None
                    os.kill(os.getpid(), -code)
                return code
    os.execv(BIN / name, [str(BIN / name), *words])


def _umask() -> int:
    value = os.umask(0)
    os.umask(value)
    return value


def serve(address: str, ready: int) -> None:
    """Import the libraries, then fork a child for each connection until the parent closes the standard input."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    fixed, listener = _fixed(), socket.socket(socket.AF_UNIX)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in IMPORTED:
            import_module(name)
    gc.freeze()  # else a collection in a child copies all that was imported
    assert threading.active_count() == 1, "a fork copies one thread alone"
    listener.bind(address)
    listener.listen(64)
    os.write(ready, b".")
    os.close(ready)
    poll, children = select.poll(), {}  # {file descriptor of a child or of its connection: (child, both, connection)}
    for file in (0, listener.fileno()):
        poll.register(file, select.POLLIN | select.POLLHUP)
    while True:
        for file, _ in poll.poll():
            if file == 0:
                return
            if file == listener.fileno():
                connection, _ = listener.accept()
                if (child := _forked(connection, fixed, listener)) is None:
                    connection.close()
                    continue
                both = os.pidfd_open(child), connection.fileno()
                children |= dict.fromkeys(both, (child, both, connection))
                for one in both:
                    poll.register(one, select.POLLIN | select.POLLHUP)
            elif file in children:  # it ended, or who started it did
                child, both, connection = children[file]
                if file == connection.fileno():
                    os.kill(child, signal.SIGKILL)
                code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
                for one in both:
                    poll.unregister(one)
                    del children[one]
                os.close(both[0])
                with contextlib.suppress(OSError):
                    connection.sendall(f"{code}\n".encode())
                connection.close()


def _forked(connection: socket.socket, fixed: dict[str, str], listener: socket.socket) -> int | None:
    """Fork what a connection asks for; return the child, or None where its libraries would be imported otherwise."""
    _, passed, _, _ = connection.recvmsg(1, socket.CMSG_SPACE(12))
    streams = [file for _, _, data in passed for file in array.array("i", data)]
    told, child = connection.makefile("r").readline(), None  # "": who asked has been killed
    wanted = json.loads(told or "{}")
    if told and wanted["fixed"] == fixed and (child := os.fork()) == 0:
        listener.close()
        connection.close()
        _run(wanted, streams)
    for file in streams:
        os.close(file)
    if child is not None:
        connection.sendall(f"{child}\n".encode())
    return child


def _run(wanted: dict, streams: list[int]) -> None:
    """Be the child: take what belongs to a process from the one that was started, and be its program."""
    for stream, file in enumerate(streams):
        os.dup2(file, stream)
    os.closerange(3, 256)
    try:
        os.setpgid(0, wanted["group"])
    except PermissionError:  # of another session
        os.setsid()
    os.chdir(wanted["folder"])
    os.umask(wanted["umask"])
    os.nice(max(wanted["nice"] - os.nice(0), 0))
    for limit, values in zip(LIMITS, wanted["limits"], strict=True):
        resource.setrlimit(limit, values)
    os.environ.clear()
    os.environ.update(wanted["environment"])
    sys.path[0] = str(Path(wanted["script"]).resolve().parent)
    sys.executable = shutil.which("python") or sys.executable  # what it starts is forked too
    sys.dont_write_bytecode = bool(os.environ.get("PYTHONDONTWRITEBYTECODE"))
    sys.argv[:] = [wanted["script"], *wanted["words"]]
    code: object = 1
    try:
        runpy.run_path(os.path.abspath(wanted["script"]), run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code
    except BaseException:
        sys.excepthook(*sys.exc_info())
    sys.exit(code)


@contextlib.contextmanager
def programs() -> Iterator[Path]:
    """Serve; the value is the folder of programs, for the path."""
    with tempfile.TemporaryDirectory(prefix="warm_") as folder:
        address, here = Path(folder) / "socket", Path(__file__).resolve()
        (Path(folder) / "bin").mkdir()
        for program in BIN.iterdir():
            file = Path(folder) / "bin" / program.name
            if program.name in PROGRAMS:
                file.write_text(STARTER.format(python=sys.executable, here=here, socket=address, name=program.name))
                file.chmod(0o755)
            else:
                file.symlink_to(program)
        reading, writing = os.pipe()
        line = [sys.executable, here, "--serve", str(address), str(writing)]
        server = subprocess.Popen(line, stdin=subprocess.PIPE, pass_fds=[writing])
        os.close(writing)
        if not os.read(reading, 1):
            raise SystemExit("The process that programs are forked from did not start")
        try:
            yield Path(folder) / "bin"
        finally:
            server.communicate()


def main() -> int:
    """Serve, start one program, or run a command with all of them; return the exit code."""
    match sys.argv[1:]:
        case ["--serve", address, ready]:
            return serve(address, int(ready))
        case ["--program", address, name, *words]:
            return start(address, name, words)
        case ["--help" | "-h"] | []:
            print(__doc__)
            return 0
        case command:
            with programs() as folder:
                path = os.pathsep.join([str(folder), str(BIN), os.environ["PATH"]])
                return subprocess.run(command, env=os.environ | {"PATH": path}, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
