"""What of a page is executed: its commands and Python in order, placeholders replaced, less what others run."""

import runpy
import subprocess
from pathlib import Path

import pytest
import yaml

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "execute_commands.py"))
PAGE = """# A page

```{note}
no command
```

```{toctree}
```

    csstsim chip FILE --chip 9 \\
        --output one   # what it is for
    make test

The table `objects.csv`:

```text
ra,dec
1,2
```

```python
a = 1
```

Then:

```python
print(a + more, "FILE")
```

    csstsim report FILE    the page, once more
"""


@pytest.fixture
def page(tmp_path):
    (tmp_path / "page.md").write_text(PAGE)
    return tmp_path / "page.md"


def script_of(page, entry, elsewhere=("make ",)):
    return SCRIPT["script"](page, entry, elsewhere, page.parent)


def test_commands_and_python_run_in_order(page):
    entry = {"replace": {"FILE": "a.yaml"}, "before": "cd sky", "python": "more = 2"}
    assert script_of(page, entry) == (
        "cd sky\ncsstsim chip a.yaml --chip 9 \\\n    --output one\npython $SHOWN/block_2.py\ncsstsim report a.yaml\n"
    )
    code = (page.parent / "block_2.py").read_text()
    assert subprocess.run(["python3", "-c", code], capture_output=True, text=True).stdout == "3 a.yaml\n"


def test_what_others_execute_is_left_out(page):
    whole = {"make ", "csstsim report FILE", "csstsim "}
    assert script_of(page, {}, whole).startswith("    --output one\npython")


def test_settings_speak_of_pages_that_show_commands():
    settings = yaml.safe_load(SCRIPT["SETTINGS"].read_text())
    for name, entry in settings["pages"].items():
        page = SCRIPT["ROOT"] / name
        assert {language for language, _ in SCRIPT["blocks"](page)} & {"sh", "python"}, name
        text = page.read_text()
        assert not [old for old in entry.get("replace", {}) if old not in text], name


def test_a_file_that_the_page_shows_is_written(page):
    script_of(page, {"files": {"objects.csv": "ra,dec"}})
    assert (page.parent / "objects.csv").read_text() == "ra,dec\n1,2\n"


def test_python_of_a_module_that_is_not_installed_is_named(page, capsys):
    page.write_text("```python\nimport no_such_module\n```\n")
    assert script_of(page, {"before": "cd sky"}) == ""
    assert "no_such_module is not installed" in capsys.readouterr().out
