"""The notebooks run from top to bottom."""

import pathlib

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((pathlib.Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path):
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:  # it shows as much after a third of its training
        cell.source = cell.source.replace("total_steps=300", "total_steps=100")
    assert any("total_steps=100" in cell.source for cell in notebook.cells)
    NotebookClient(
        notebook, timeout=400, kernel_name="python3", resources={"metadata": {"path": path.parent}}
    ).execute()
    printed = "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", []))
    pictures = [o for cell in notebook.cells for o in cell.get("outputs", []) if "image/png" in o.get("data", {})]
    assert "success" in printed
    assert len(pictures) >= 3


def test_there_is_a_notebook():
    assert [path.stem for path in NOTEBOOKS][:1] == ["01_first_robot"]
