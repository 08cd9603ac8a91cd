"""The paper's scenes: found in folders of the sets' layouts, fetched by digest, and set beside the paper's figures."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path

import pytest

from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.published.__main__ import fetch, scenes_in
from benchmarks.published.paper import PAPER, tables
from fastsplat.service.capture.settings import CaptureSettings
from tests.benchmarks.evaluation import made_data


def test_scenes_of_both_layouts_are_found_and_read_as_what_the_paper_measured(tmp_path: Path) -> None:
    made_data.lerf_ovs(tmp_path / "lerf_ovs", [2, 41, 105], [41])
    made_data.three_d_ovs(tmp_path / "3D-OVS" / "Covered-Desk", 5, ["01", "04"])
    found = scenes_in(tmp_path)
    assert found == {"teatime": tmp_path / "lerf_ovs/teatime", "covered_desk": tmp_path / "3D-OVS/Covered-Desk"}
    for name, folder in found.items():
        assert read_dataset(folder, CaptureSettings()).kind == PAPER[name].data_set
    made_data.three_d_ovs(tmp_path / "again" / "covered_desk", 5, ["01"])
    with pytest.raises(SystemExit, match="both called covered_desk"):
        scenes_in(tmp_path)


def test_an_archive_is_unpacked_only_where_it_is_the_one_that_was_meant(tmp_path: Path) -> None:
    archive, folder = tmp_path / "set.zip", tmp_path / "set"
    with zipfile.ZipFile(archive, "w") as made:
        made.writestr("bed/images/0.png", b"")
    digest = hashlib.sha256(archive.read_bytes()).hexdigest()
    for wrong, said in (("", "needs --sha256"), ("0" * 64, digest)):
        with pytest.raises(SystemExit, match=said):
            fetch(archive.as_uri(), wrong, folder)
        assert not folder.exists()
    fetch(archive.as_uri(), digest, folder)
    assert scenes_in(folder) == {"bed": folder / "bed"}


def test_what_was_measured_stands_beside_the_papers_and_means_are_of_whole_sets() -> None:
    bed = {"miou": 0.5, "localization": None, "minutes": 2.0}
    alone = tables({"bed": bed})
    assert "| bed | 0.925 | 0.643 | 0.933 | 0.500 |" in alone
    assert "| bed | 0.992 | 0.961 | 0.998 | not measured |" in alone
    assert "| bed | 79.23 | 107.25 | 13.96 | 2.00 |" in alone and "mean" not in alone and "lerf_ovs" not in alone
    whole = tables({"bed": bed, "covered_desk": {"miou": 0.7, "localization": 1.0, "minutes": 4.0}})
    assert "| mean | 0.852 | 0.661 | 0.923 | 0.600 |" in whole  # as the paper's own means
    assert "| mean | 0.985 | 0.928 | " in whole and whole.count("mean") == 2 and whole.count("not measured") == 2
