"""pre-commit runs what `make test` runs, apart from what takes longer than a commit: the site, the wheel, pytest."""

from pathlib import Path

import yaml

LONG = ["$(MAKE) docs", "python benchmarks/first_image.py", "pytest"]
ROOT = Path(__file__).parents[1]


def test_hooks_are_the_commands_of_make_test():
    recipe = (ROOT / "Makefile").read_text().split("\ntest: ")[1].split("\n\n")[0]
    commands = [line.strip() for line in recipe.splitlines()[1:]]
    assert commands[-3:] == LONG[:2] + commands[-1:] and commands[-1].startswith(LONG[2])
    [local] = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert local["repo"] == "local"
    assert [hook["entry"] for hook in local["hooks"]] == commands[:-3]
    for hook in local["hooks"]:
        assert hook["language"] == "system" and hook["pass_filenames"] is False
