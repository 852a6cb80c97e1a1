"""A process that tries hostile inputs, watched and with limited memory; it is replaced if it dies or hangs.

The outcome of an input is ("read", ""), ("refused", message) or a fault, ("fault", why): a traceback, a crash, a hang,
unlimited memory use, executed code, a file written elsewhere, a message that is not one short printable line.
"""

import importlib
import multiprocessing
import os
import platform
import resource
import sys
import traceback
from pathlib import Path
from unittest import mock

MEMORY = 1 << 30  # bytes a worker may ask for beyond what it has when it starts
SECONDS = 20.0  # for one input; a sound one takes milliseconds, a busy machine forgives no ten thousand times that
LONGEST = 2000  # characters of a message
SLOW_TO_IMPORT = ("fuzz.readers", "pyarrow.parquet", "healpy", "matplotlib.pyplot")  # and write caches of their own
_CODE = ("os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen", "socket.connect", "pty.spawn")
_CHANGES = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.chmod", "os.truncate",
            "shutil.rmtree", "shutil.move")  # fmt: skip


class Worker:
    """Runs readers, named "module:function", on paths; `folder` is the only place where they may write."""

    def __init__(self, folder, seconds=SECONDS):
        self.folder, self.seconds, self._process = Path(folder), seconds, None

    def __call__(self, function, path, seconds=None):
        """Return (outcome, text) of function(path) in the process; it has its usual time, or so many seconds."""
        if self._process is None:
            self._start()
            self._ask("builtins:len", "", self.seconds)  # its imports are not the input's time
        return self._ask(function, str(path), seconds or self.seconds)

    def _ask(self, function, path, seconds):
        try:
            self._pipe.send((function, path))
            if self._pipe.poll(seconds):
                return self._pipe.recv()
            why = f"still at it after {seconds:g} s"
        except (EOFError, OSError):
            self._process.join(5)
            why = f"the process died with {self._process.exitcode}"
        self.close()
        return "fault", why

    def _start(self):
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(SLOW_TO_IMPORT))  # a second of each process's time
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, str(self.folder)), daemon=True)
        # Pools of memory are reserved in advance: they would count as used
        with mock.patch.dict(os.environ, ARROW_DEFAULT_MEMORY_POOL="system", MALLOC_ARENA_MAX="1"):
            self._process.start()
        theirs.close()
        self._pipe.poll(120)
        self._pipe.recv()  # it is ready

    def close(self):
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None


def _serve(pipe, folder):
    """Answer requests until the pipe closes."""
    sys.dont_write_bytecode = True
    for name in SLOW_TO_IMPORT:
        importlib.import_module(name)
    platform.processor()  # starts a process when a library first asks
    escaped = []
    sys.addaudithook(lambda event, args: _watch(event, args, folder, escaped))
    have = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (have + MEMORY, have + MEMORY))
    pipe.send("ready")
    while True:
        try:
            name, path = pipe.recv()
        except EOFError:
            return
        module, _, function = name.partition(":")
        escaped.clear()
        outcome = _outcome(getattr(importlib.import_module(module), function), path)
        pipe.send(("fault", f"escaped: {escaped[0]}") if escaped else outcome)


def _outcome(function, path):
    from csstsim.base.errors import CsstsimError

    try:
        function(path)
    except CsstsimError as error:
        return _judge(error)
    except BaseException as error:
        return "fault", "".join(traceback.format_exception(error))[-4000:]
    return "read", ""


def _judge(error):
    text, cause = str(error), error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "fault", f"asked for more than {MEMORY >> 20} MB before it was refused: {text[:500]}"
        cause = cause.__cause__ or cause.__context__
    if not text.isprintable() or len(text) > LONGEST:
        return "fault", f"no short printable line: {text[:500]!r}"
    return "refused", text


def _watch(event, args, folder, escaped):
    """Note what an input must never bring about."""
    if event in _CODE or (event == "import" and args[0] == "fuzz_tripwire"):
        escaped.append((event, str(args)[:200]))
    elif (event == "open" and _writes(*args[1:3])) or event in _CHANGES:
        path = os.fspath(args[0]) if isinstance(args[0], str | os.PathLike) else args[0]
        inside = isinstance(path, str) and f"{os.path.realpath(path)}/".startswith(f"{os.path.realpath(folder)}/")
        compiled = "__pycache__" in str(path) or str(path).startswith(os.environ.get("NUMBA_CACHE_DIR") or "\0")
        # A number is a descriptor opened before; numba keeps its compiled code
        if not (inside or isinstance(path, int) or path == os.devnull or compiled):
            escaped.append((event, str(args)[:200]))


def _writes(mode, flags):
    named = isinstance(mode, str) and bool(set(mode) & set("wax+"))
    return named or bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
