"""The notebook runs from top to bottom, and shows what it says."""

from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from slbench.core.io import read_ply

NOTEBOOK = Path(__file__).parents[2] / "docs" / "examples" / "first-scan.ipynb"
#: Seconds for a cell; the whole takes about 17 of processor time.
LIMIT = 120


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Run the notebook in an empty folder; return it with its outputs, and the folder."""
    folder = tmp_path_factory.mktemp("notebook")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=LIMIT, kernel_name="python3", resources=resources).execute()
    return notebook, folder


def shown(notebook, source):
    """Return what the cell that ends in `source` shows, by type."""
    (cell,) = (
        c for c in notebook.cells if c.cell_type == "code" and c.source.splitlines()[-1] == source
    )
    return cell.outputs[-1]["data"]


def test_it_is_stored_without_outputs():
    cells = [c for c in nbformat.read(NOTEBOOK, as_version=4).cells if c.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)


@pytest.mark.slow
def test_values_show_tables_and_pictures(ran):
    notebook, _ = ran
    assert "<table>" in shown(notebook, "result")["text/html"]
    assert "<table>" in shown(notebook, "comparison")["text/html"]
    assert shown(notebook, "scene")["text/plain"].startswith("<Scene step-block")
    plots = [c.source for c in notebook.cells if c.source.endswith(".plot()")]
    assert len(plots) >= 6
    for source in plots:
        assert "image/png" in shown(notebook, source.splitlines()[-1])


@pytest.mark.slow
def test_its_cloud_is_the_step_block(ran):
    _, folder = ran
    points, fields = read_ply(folder / "cloud.ply")
    assert np.ptp(np.percentile(points[:, 2], [1, 99])) == pytest.approx(10.0, abs=0.3)
    assert np.all(fields["sigma"] > 0.0)
