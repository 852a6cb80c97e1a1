"""csstsim's commands, run in the process of a test."""

from click.testing import CliRunner

from csstsim.command_line.main import main


def command(*arguments):
    """Run a command; return its click result."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def done(*arguments):
    """Run a command that must succeed; return what it printed."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments):
    """Run a command whose input must be refused; return its one line."""
    result = command(*arguments)
    lines = result.stderr.strip().splitlines()
    assert result.exit_code == 2, (result.output, result.exception)
    assert len(lines) == 1 and lines[0].startswith("csstsim: error: "), lines
    return lines[0]
