"""A command whose reader has closed, or that gets a signal, ends quietly and leaves no half-written file."""

import signal
import subprocess
import sys
import time

WRITER = """
import time
from csstsim.base.files.atomic import atomic_path
from csstsim.command_line.main import main

@main.command()
def write():
    with atomic_path({path!r}) as temporary:
        temporary.write_text("half")
        time.sleep(60)

main(["write"])
"""


def test_a_closed_pipe_ends_quietly():
    """The list of layers is longer than what a pipe holds until its reader is gone."""
    command = [sys.executable, "-c", "from csstsim.command_line.main import main; main(['layers'])"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait() == 128 + signal.SIGPIPE
    process.stderr.close()


def test_what_is_printed_last_meets_a_closed_pipe(tmp_path):
    """Without the flush of the command, Python's own at exit complains."""
    code = "from csstsim.command_line.main import main\n@main.command()\ndef say():\n    print('done')\nmain(['say'])"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert (process.stderr.read(), process.wait()) == (b"", 128 + signal.SIGPIPE)
    process.stderr.close()


def test_output_closed_from_the_start_is_no_error():
    code = "import sys; sys.stdout = None; from csstsim.command_line.main import main; main(['layers'])"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_half_a_file_is_removed_when_told_to_stop(tmp_path):
    path = tmp_path / "product.txt"
    process = subprocess.Popen([sys.executable, "-c", WRITER.format(path=str(path))])
    end = time.monotonic() + 30
    while not list(tmp_path.iterdir()):
        assert time.monotonic() < end and process.poll() is None
        time.sleep(0.02)
    process.terminate()
    assert process.wait(timeout=30) == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == []
