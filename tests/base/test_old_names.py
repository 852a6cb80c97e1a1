"""Old names warn where they are used, and are removed in the version that their warning names."""

import ast
import warnings
from pathlib import Path

import pytest
from packaging.version import Version

import csstsim
from csstsim.base.old_names import warn_old_name

SOURCES = sorted(Path(csstsim.__file__).parent.rglob("*.py"))


def promised():
    """Return {file:line: the version that a call with the keyword `goes` names}."""
    calls = (
        (path, node)
        for path in SOURCES for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
    )  # fmt: skip
    return {
        f"{path.name}:{node.lineno}": ast.literal_eval(word.value)
        for path, node in calls for word in node.keywords
        if word.arg == "goes"
    }  # fmt: skip


def test_no_old_name_is_older_than_promised():
    assert len(promised()) >= 4
    due = {place: goes for place, goes in promised().items() if Version(csstsim.__version__) >= Version(goes)}
    assert not due, f"these old names go in version {csstsim.__version__}: {due}"


def test_all_deprecation_warnings_name_the_version():
    others = [path.name for path in SOURCES if path.name != "old_names.py" and "DeprecationWarning" in path.read_text()]
    assert not others


def test_the_warning_is_at_the_users_line():
    def renamed():
        warn_old_name("give new", goes="9.0.0")

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        renamed()
    line = Path(__file__).read_text().splitlines()[caught[0].lineno - 1]
    assert caught[0].filename == __file__ and line.strip() == "renamed()"
    with pytest.warns(DeprecationWarning, match=r"give new; the old form goes in 9\.0\.0"):
        renamed()
