"""pre-commit runs the same checks as `make style`, which is `make checks` without the site: that takes too long."""

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]


def test_hooks_are_the_commands_of_make_style():
    recipe = (ROOT / "Makefile").read_text().split("\nstyle: ")[1].split("\n\n")[0]
    commands = [line.strip() for line in recipe.splitlines()[1:]]
    [local] = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert local["repo"] == "local"
    assert [hook["entry"] for hook in local["hooks"]] == commands
    for hook in local["hooks"]:
        assert hook["language"] == "system" and hook["pass_filenames"] is False
