"""Every notebook runs from top to bottom in a fresh kernel."""

import os
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.py"))
SECONDS = 120


@pytest.mark.filterwarnings("default")  # of the notebook machinery, not of the package
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs(path, tmp_path):
    try:
        import jupytext
        from nbclient import NotebookClient
    except ImportError as missing:
        if os.environ.get("CI"):
            raise
        pytest.skip(f"needs {missing.name}: pip install 'slipfree[test]'")
    notebook = jupytext.read(path)
    client = NotebookClient(
        notebook, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    )
    client.execute()
    assert any(cell.cell_type == "code" and cell.outputs for cell in notebook.cells)
