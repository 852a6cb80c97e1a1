"""pre-commit runs what `make test` runs, pytest apart."""

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]


def test_hooks_are_the_commands_of_make_test():
    recipe = (ROOT / "Makefile").read_text().split("\ntest: ")[1].split("\n\n")[0]
    commands = [line.strip() for line in recipe.splitlines()[1:]]
    assert [command for command in commands if command.startswith("pytest")] == commands[-1:]
    [local] = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert local["repo"] == "local"
    assert [hook["entry"] for hook in local["hooks"]] == commands[:-1]
    for hook in local["hooks"]:
        assert hook["language"] == "system" and hook["pass_filenames"] is False
