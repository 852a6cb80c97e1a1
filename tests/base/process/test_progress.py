"""Progress bars at a terminal, none in a log."""

import io
import os
import pty
import subprocess
import sys

import pytest

from csstsim.base.process.progress import hidden, progress

LOOPS = """
from csstsim.base.process.progress import hidden, progress
from contextlib import nullcontext
with {how}:
    for outer in progress("ab", "the outer loop"):
        for inner in progress(iter("cd"), "the inner loop", 2):
            print(outer + inner)
"""
ORDER = "ac\nad\nbc\nbd\n"


def at_a_terminal(code, both=False):
    """Run code with standard error at a terminal, standard output in a pipe or there, too; return what each got."""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=slave if both else subprocess.PIPE, stderr=slave,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "80"}, text=True,
    )  # fmt: skip
    os.close(slave)
    out, seen = "" if both else process.stdout.read(), b""
    try:
        while part := os.read(master, 4096):
            seen += part
    except OSError:  # the terminal's other end is closed
        pass
    os.close(master)
    if not both:
        process.stdout.close()
    assert process.wait() == 0
    return out, seen.decode()


def test_bars_at_a_terminal_one_below_the_other():
    out, seen = at_a_terminal(LOOPS.format(how="nullcontext()"))
    assert out == ORDER  # not drawn into the bars, which go elsewhere
    assert "the outer loop" in seen and "the inner loop" in seen


def test_what_is_printed_above_the_bars_is_not_broken_into_lines():
    _, seen = at_a_terminal(LOOPS.format(how="nullcontext()") + "            print('x' * 150)", both=True)
    assert seen.count("x" * 150 + "\r\n") == 4 and "the inner loop" in seen


def test_no_bars_where_they_are_hidden():
    assert at_a_terminal(LOOPS.format(how="hidden()")) == (ORDER, "")


def test_no_bars_in_a_log():
    done = subprocess.run(
        [sys.executable, "-c", LOOPS.format(how="nullcontext()") + "import sys; assert 'rich' not in sys.modules"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == (ORDER, "")


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_items_are_those_given(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert list(progress([], "none")) == [] and list(progress(iter("ab"), "of no known length")) == ["a", "b"]
    given = progress("abc", "left early")
    assert next(given) == "a"
    given.close()
    assert list(progress("de", "after that")) == ["d", "e"]  # a new set of bars
    with hidden():
        assert list(progress("ab", "hidden")) == ["a", "b"]


def test_an_error_in_the_loop_ends_the_bars(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with pytest.raises(KeyError):
        for _ in progress("ab", "broken"):
            raise KeyError("in the loop")
    assert list(progress("ab", "next")) == ["a", "b"]


NOTEBOOK = """
import time
from csstsim.base.process.progress import progress, tell_once
for item in progress(iter("ab"), "a <short> loop", 2):
    pass
for item in progress("abc", "a <long> loop"):
    time.sleep(0.3)
tell_once("a line")
tell_once("a line")
"""


def test_a_notebook_shows_a_bar_of_long_loops_below_the_cell():
    """The bar is updated in place, and is gone at the end."""
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    updates = []

    class Client(client.NotebookClient):
        def process_message(self, message, cell, index):
            if message["msg_type"] in ("display_data", "update_display_data"):
                updates.append(message["content"]["data"]["text/html"])
            return super().process_message(message, cell, index)

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(NOTEBOOK)])
    Client(notebook, timeout=100).execute()
    assert updates[0] == updates[-1] == "" and not any("short" in text for text in updates)
    assert any("a &lt;long&gt; loop" in text and 'value="1" max="3"' in text for text in updates)
    outputs = notebook.cells[0].outputs
    assert [output.get("text") for output in outputs if output.output_type == "stream"] == ["a line\n"]
