"""pre-commit runs the same checks as `make checks`, except for the site, which takes too long for a commit."""

from pathlib import Path

import yaml

SITE = "$(MAKE) docs"
ROOT = Path(__file__).parents[1]


def test_hooks_are_the_commands_of_make_checks():
    recipe = (ROOT / "Makefile").read_text().split("\nchecks: ")[1].split("\n\n")[0]
    commands = [line.strip() for line in recipe.splitlines()[1:]]
    assert commands[-1] == SITE
    [local] = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert local["repo"] == "local"
    assert [hook["entry"] for hook in local["hooks"]] == commands[:-1]
    for hook in local["hooks"]:
        assert hook["language"] == "system" and hook["pass_filenames"] is False
