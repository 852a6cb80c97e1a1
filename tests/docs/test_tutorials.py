"""The site shows what tutorials printed when they were executed: of each the present code, without an error."""

import runpy
from pathlib import Path

import nbformat
import pytest

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "execute_tutorials.py"))
TUTORIALS = SCRIPT["tutorials"]()
LARGEST = 1_000_000  # bytes of a file in the repository


@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_was_executed_as_it_is(name):
    file = SCRIPT["EXECUTED"] / f"{name}.ipynb"
    shown = nbformat.read(file, as_version=4)
    assert [cell.source for cell in shown.cells] == [cell.source for cell in TUTORIALS[name].cells], "make tutorials"
    outputs = [output for cell in shown.cells for output in cell.outputs]
    assert outputs and not any(output.output_type == "error" for output in outputs)
    assert file.stat().st_size < LARGEST
