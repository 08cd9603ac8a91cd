"""The notebook of the documentation runs from its first cell to its last, and shows what it says."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from tests.docs.page_blocks import ROOT

_NOTEBOOK = ROOT / "docs" / "first_scene.ipynb"


@pytest.fixture(scope="module")
def executed(
    photos: Path, small_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> nbformat.NotebookNode:
    place = tmp_path_factory.mktemp("notebook")
    (place / "docs").mkdir()
    (place / "demo").mkdir()
    (place / "demo" / "sample").symlink_to(photos)
    notebook = nbformat.read(_NOTEBOOK, as_version=4)
    client = NotebookClient(notebook, timeout=540, resources={"metadata": {"path": str(place / "docs")}})
    client.execute(env={**small_environment, "FASTSPLAT_TRAINING__ITERATIONS": "200"})  # enough for its answers
    assert (place / "docs" / "desk-scene").is_dir()
    return notebook


def test_the_notebook_is_committed_without_outputs_and_is_valid() -> None:
    notebook = nbformat.read(_NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert _NOTEBOOK.stat().st_size < 20_000
    assert not [cell for cell in notebook.cells if cell.get("outputs") or cell.get("execution_count")]


def test_answers_are_said(executed: nbformat.NotebookNode) -> None:
    said = "".join(output.text for cell in executed.cells for output in cell.get("outputs", ()) if "text" in output)
    assert "banana: Here:" in said and "bicycle: Not here" in said
    assert "my lunch" in said and " pixels of images/000.jpg" in said


def test_cells_show_pictures_and_the_viewer(executed: nbformat.NotebookNode) -> None:
    outputs = [output.data for cell in executed.cells for output in cell.get("outputs", ()) if "data" in output]
    assert sum("image/png" in data for data in outputs) == 2
    (page,) = (data["text/html"] for data in outputs if "text/html" in data)
    assert page.startswith("<iframe srcdoc=") and "my lunch" in page
