"""pre-commit runs the same checks as `make style types`: `make checks` without the site, which takes too long."""

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]


def test_hooks_are_the_commands_of_make_style_and_types():
    makefile = (ROOT / "Makefile").read_text()
    recipes = [makefile.split(f"\n{target}: ")[1].split("\n\n")[0] for target in ("style", "types")]
    commands = [line.strip() for recipe in recipes for line in recipe.splitlines()[1:]]
    [local] = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert local["repo"] == "local"
    assert [hook["entry"] for hook in local["hooks"]] == commands
    for hook in local["hooks"]:
        assert hook["language"] == "system" and hook["pass_filenames"] is False
