"""Execute the tutorials: python docs/execute_tutorials.py [NAME]...      default: all; some minutes.

Each tutorial runs in an empty folder of its own, and stops at its first error. Its code cells with all they print and
draw go to docs/tutorials/executed, from where the site takes them (docs/conf.py).
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import nbformat
from myst_nb.core.read import read_myst_markdown_notebook
from nbclient import NotebookClient

TUTORIALS = Path(__file__).resolve().parent / "tutorials"
EXECUTED = TUTORIALS / "executed"
LONGEST = 1800  # s a cell: a campaign runs in one
NotebookClient.coalesce_streams = True  # a command's output comes in pieces, cut anywhere


def tutorials():
    """Return {name: nbformat notebook of its code cells} of all tutorials."""
    found = {}
    for page in sorted(TUTORIALS.glob("*.md")):
        notebook = read_myst_markdown_notebook(page.read_text(), path=page)
        notebook.cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
        if notebook.cells:
            found[page.stem] = notebook
    return found


def executed(notebook):
    """Return the notebook executed. Raises CellExecutionError of nbclient for a cell that fails."""
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=LONGEST, resources={"metadata": {"path": folder}}).execute()
    for number, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{number}", {}  # else they would have random names, and times
        cell.outputs = [output for output in cell.outputs if output.get("data", {}).get("text/html") != ""]  # past bars
        for output in cell.outputs:
            if "text" in output:
                output["text"] = output["text"].replace(folder, "~")
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"]}
    return notebook


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *tutorials()], metavar="NAME")
    names = parser.parse_args().names
    EXECUTED.mkdir(exist_ok=True)
    for name, notebook in tutorials().items():
        if not names or name in names:
            start = time.monotonic()
            nbformat.write(executed(notebook), EXECUTED / f"{name}.ipynb")
            print(f"{name}: {time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    sys.exit(main())
