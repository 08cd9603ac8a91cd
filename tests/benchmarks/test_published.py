"""The paper's scenes: found in folders of the sets' layouts, fetched by digest, and set beside the paper's figures."""

from __future__ import annotations

import hashlib
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.published.__main__ import fetch, scenes_in
from benchmarks.published.llff import with_transforms
from benchmarks.published.paper import tables
from fastsplat.service.capture.capture_settings import CaptureSettings
from tests.benchmarks.evaluation import made_data


def test_cameras_of_llff_are_those_of_the_same_scene_in_colmap(tmp_path: Path) -> None:
    folder, camera, rows = made_data.three_d_ovs(tmp_path / "bed", 6, ["01", "04"]), made_data.CAMERA, []
    wanted = read_dataset(with_transforms(folder, tmp_path / "work"), CaptureSettings())
    shutil.rmtree(folder / "sparse")
    for pose in made_data.poses(6):
        right, down, forward, position = pose[:3].T
        matrix = np.stack([down, right, -forward, position, [camera.height, camera.width, camera.fx]], axis=1)
        rows.append([*matrix.ravel(), 0.5, 9.0])
    np.save(folder / "poses_bounds.npy", rows)
    read = read_dataset(with_transforms(folder, tmp_path / "work"), CaptureSettings())
    assert read.kind == "3d_ovs" and len(read.train) == len(wanted.train)
    for view, target in zip(read.test, wanted.test, strict=True):
        assert view.name == f"images/{target.name}" and view.queries
        assert view.posed is not None and target.posed is not None and view.posed.camera == target.posed.camera
        np.testing.assert_allclose(view.posed.world_from_camera, target.posed.world_from_camera, atol=1e-12)


def test_an_archive_is_unpacked_only_where_it_is_the_one_that_was_meant(tmp_path: Path) -> None:
    archive, folder = tmp_path / "set.zip", tmp_path / "set"
    with zipfile.ZipFile(archive, "w") as writer:
        writer.writestr("bed/images/0.png", b"")
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
