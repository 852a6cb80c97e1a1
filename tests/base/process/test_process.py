"""Memory given back, kernels without BLAS, bars of loops and files that are made first."""

import ctypes
import gc
import io
import sys
import weakref

import pytest

from csstsim.base.process import no_blas, progress
from csstsim.base.process.memory import release


class Node:
    pass


def test_cycles_and_free_memory_are_given_back(monkeypatch):
    """glibc is asked to keep no padding; a C library without that function is no error."""
    asked = []
    library = type("Library", (), {"malloc_trim": staticmethod(asked.append)})
    monkeypatch.setattr(ctypes, "CDLL", lambda name: library if name is None else None)
    node = Node()
    node.self = node
    gone = weakref.ref(node)
    gc.disable()
    try:
        del node
        release()
    finally:
        gc.enable()
    assert gone() is None and asked == [0]
    for error in (AttributeError, OSError, TypeError):

        def missing(_, error=error):
            raise error

        monkeypatch.setattr(ctypes, "CDLL", missing)
        release()


def test_numba_does_not_look_for_a_blas():
    assert no_blas.numba.np.linalg.ensure_blas() is None
    assert no_blas.numba.np.linalg.ensure_blas.__module__ == "csstsim.base.process.no_blas"


class Terminal(io.StringIO):
    def __init__(self, is_one):
        super().__init__()
        self.is_one = is_one

    def isatty(self):
        return self.is_one


@pytest.mark.parametrize("is_one", [True, False])
def test_bars_are_drawn_at_a_terminal_alone(monkeypatch, is_one):
    """Named, on standard error; inner loops use the outer one's screen, and the last one leaves none."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Terminal(is_one))
    seen = []
    for outer in progress.progress("ab", "outer loop"):
        screen = progress._screen["bars"]
        for inner in progress.progress(iter("cd"), "inner loop", 2):
            seen.append(outer + inner)
            assert progress._screen["bars"] is screen
            if screen is not None:
                drawn = [(task.description, task.total) for task in screen.tasks]
                assert drawn == [("outer loop", 2), ("inner loop", 2)]
        if screen is not None:
            assert [task.description for task in screen.tasks] == ["outer loop"]
    assert seen == ["ac", "ad", "bc", "bd"] and progress._screen["bars"] is None
    assert (screen is not None) is is_one


def test_hidden_bars_stay_hidden_until_the_outermost_end(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal(True))

    def drawn():
        for _ in progress.progress("a", "one"):
            return progress._screen["bars"] is not None

    with pytest.raises(KeyError), progress.hidden():
        with progress.hidden():
            assert not drawn()
        assert not drawn()
        raise KeyError
    assert drawn()
    monkeypatch.setattr(sys, "stderr", None)
    assert list(progress.progress("ab", "without a screen")) == ["a", "b"]


def test_what_is_missing_is_made_first_and_once(tmp_path):
    """In order; what is there is left alone, and what comes with another file is not made again."""
    there, one, two, three = (tmp_path / name for name in ("there", "one", "two", "three"))
    there.write_text("old")
    made, said = [], []

    def make(path, *more):
        def function():
            made.append(path.name)
            for each in (path, *more):
                each.write_text("new")

        return function

    progress.make_missing({there: make(there), one: make(one, two), two: make(two), three: make(three)}, said.append)
    assert made == ["one", "three"] and there.read_text() == "old"
    assert said == [f"missing, made first: {one}", f"missing, made first: {three}"]


def test_bars_without_a_standard_output_or_with_one_in_a_file(monkeypatch):
    """What is printed is drawn above the bars at a terminal alone; a program without an output has bars, too."""
    given = []

    class Bars:
        def __init__(self, *, redirect_stdout, **named):
            given.append(redirect_stdout)

        def __enter__(self):
            return self

        def __exit__(self, *what):
            return None

        def add_task(self, what, total):
            return 0

        def track(self, items, total, task_id):
            return iter(items)

        def remove_task(self, task):
            return None

    monkeypatch.setattr("rich.progress.Progress", Bars)
    terminal = type("Terminal", (io.StringIO,), {"isatty": lambda self: True})
    monkeypatch.setattr(sys, "stderr", terminal())
    for output in (None, io.StringIO(), terminal()):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", output)
            items = list(progress.progress("ab", "loop"))
        assert items == ["a", "b"]
    assert given == [False, False, True]
