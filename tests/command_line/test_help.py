"""The help: verbs in groups, one line each; every verb has an example, and the examples are valid commands."""

import shlex

import click
import pytest
from click.testing import CliRunner

from csstsim.command_line.group import SECTIONS
from csstsim.command_line.main import main

VERBS = sorted(main.commands)


def examples(text):
    """Return the command lines of csstsim in a help text, as lists of words without `csstsim` and without pipes."""
    found = []
    for line in text.splitlines():
        line = line.strip().removeprefix('eval "$(').removesuffix(')"')
        if line.startswith("csstsim "):
            words = shlex.split(line.split("  ")[0].split(" | ")[0])
            found.append(words[1:])
    return found


def parsed(words):
    """Parse a command line as click does, without running it; return the verb's name and parameters."""
    with main.make_context("csstsim", list(words)) as ctx:
        name, command, rest = main.resolve_command(ctx, [*ctx._protected_args, *ctx.args])
        with command.make_context(name, rest, parent=ctx) as inner:
            return name, inner.params


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_has_an_example_that_parses(name):
    lines = examples(main.commands[name].help)
    assert lines, f"the help of {name} has no example"
    assert name in {parsed(words)[0] for words in lines}


def test_the_groups_help_has_examples_that_parse():
    lines = examples(main.help)
    assert {parsed(words)[0] for words in lines if words[0] in VERBS} >= {"plan", "chip", "show"}


def test_earlier_spellings_of_options_work_but_are_not_in_the_help():
    said = CliRunner().invoke(main, ["place", "--help"]).output
    assert "--min-separation PX" in said and "--near PATH" in said and "--apart" not in said and "--beside" not in said
    assert parsed(["place", "f", "t", "--output", "o", "--apart", "3"])[1]["min_separation"] == 3.0
    assert parsed(["place", "f", "t", "--output", "o", "--beside=k"])[1]["near"] == "k"


def test_earlier_spellings_of_options_warn(capsys):
    parsed(["place", "f", "--output", "o", "--near", "k", "--", "--apart-of"])
    assert not capsys.readouterr().err
    parsed(["place", "f", "t", "--output", "o", "--apart", "3"])
    assert capsys.readouterr().err == "warning: --apart is now --min-separation; the old form goes in 0.3.0\n"


def test_an_example_with_an_unknown_option_would_be_found():
    with pytest.raises(click.UsageError):
        parsed(["plan", "campaign.yaml", "--colour", "red"])
    with pytest.raises(click.UsageError):
        parsed(["truth", "campaign.yaml", "--brick", "BRICK"])


def test_every_verb_stands_in_one_section():
    listed = [name for names in SECTIONS.values() for name in names]
    assert sorted(listed) == VERBS


@pytest.mark.parametrize("columns", [80, 200])
def test_help_gives_each_verb_one_whole_line(columns):
    lines = CliRunner().invoke(main, ["--help"], terminal_width=columns).output.splitlines()
    for title, names in SECTIONS.items():
        start = lines.index(f"{title}:") + 1
        here = lines[start : start + len(names)]
        assert [line.split()[0] for line in here] == list(names)
        assert not any(line.endswith("...") or len(line) > 80 for line in here)


def test_a_slip_is_answered_with_what_was_meant():
    said = CliRunner().invoke(main, ["statsu"])
    assert said.exit_code == 2 and "'status'" in said.stderr


def test_layers_named_are_the_only_ones_told():
    said = CliRunner().invoke(main, ["layers", "BIAS", "gain"])
    heads = [line.split()[0] for line in said.output.splitlines() if not line.startswith(" ")]
    assert said.exit_code == 0 and heads == ["bias", "gain"]
    wrong = CliRunner().invoke(main, ["layers", "biass"])
    assert wrong.exit_code == 2 and "biass" in wrong.stderr and "bias, blooming" in wrong.stderr


@pytest.mark.parametrize(
    "words",
    [
        ["aim", "10", "2", "--output", ""], ["aim", "10", "2", "--instrument", ""], ["init", ""],
        ["init", "sky", "--catalogue", ""], ["check", ""], ["show", "x.fits", "--output", ""],
        ["chip", "c.yaml", "--obsid", "101", "--chip", "9", "--output", ""],
    ],
)  # fmt: skip
def test_an_empty_name_is_refused(words):
    said = CliRunner().invoke(main, words)
    assert said.exit_code == 2 and "an empty name" in said.stderr and "Traceback" not in said.output


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "-1"])
def test_numbers_that_are_none_are_refused(value):
    for words, name in (
        (["extract", "c.yaml", "--obsid", "101", "--chip", "29", "--snr", value], "--snr"),
        (["aim", value, "2"], "ra"), (["aim", "10", "2", "--exptime", value], "exptime"),
    ):  # fmt: skip
        said = CliRunner().invoke(main, words)
        assert said.exit_code == 2 and name in said.stderr and value in said.stderr, said.stderr
    if value != "-1":
        for words in (["10", value], ["10", "2", "--pa", value], ["10", "2", "--dither", "0", value]):
            said = CliRunner().invoke(main, ["aim", *words])
            assert said.exit_code == 2 and value in said.stderr, said.stderr
