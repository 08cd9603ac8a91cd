"""Scenes of papers: read in the sets' layouts, trained and measured to the end, and set beside the papers' figures."""

from __future__ import annotations

import hashlib
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import provenance
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.published import __main__ as published
from benchmarks.published.llff import with_transforms
from benchmarks.published.paper import PAPER, tables
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat_contract.geometry.camera import Camera
from tests.benchmarks.evaluation import made_data

_SAMPLE = Path(__file__).parents[2] / "demo/sample"


def _write_sets(root: Path) -> None:
    """A scene of each set, as it is published."""
    _sample_as_3d_ovs(root / "3d_ovs/bed")
    made_data.lerf_ovs(root / "lerf_ovs", [1, 2, 41, 105, 140], [41, 140])
    made_data.lerf_mask(root / "lerf_mask/figurines", 4, 2)
    made_data.mip_nerf_360(root / "360_v2/garden", 9)


def _sample_as_3d_ovs(folder: Path) -> None:
    """Every other photo of the sample, half its size, as points are found in photos where no model has any."""
    document, poses = json.loads((_SAMPLE / "transforms.json").read_text()), []
    camera = Camera(240, 180, document["fl_x"] / 2, document["fl_x"] / 2, 120, 90)
    for number, frame in enumerate(document["frames"][::2]):
        poses.append(np.array(frame["transform_matrix"]) * [1, -1, -1, 1])
        picture = Image.open(_SAMPLE / frame["file_path"]).reduce(2)
        made_data.save(np.asarray(picture), folder / f"images/{number:02d}.jpg")
        ids = np.asarray(Image.open(_SAMPLE / frame["mask_path"]))[::2, ::2]
        for label in ("banana", "cup") if number in (3, 9) else ():
            mask = (ids == document["labels"][label]).astype(np.uint8) * 255
            made_data.save(mask, folder / f"segmentations/{number:02d}/{label}.png")
    (folder / "segmentations/classes.txt").write_text("banana\ncup\n")
    made_data.with_poses_bounds(folder, poses, camera)


@pytest.mark.usefixtures("models_dir")
def test_a_scene_of_each_set_is_trained_and_measured_and_printed_beside_the_paper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _write_sets(tmp_path / "sets")
    monkeypatch.setattr(provenance, "DRAFT", str(tmp_path))
    monkeypatch.setattr(published, "RESULTS", tmp_path)
    options = ["--preset", "draft", "--labels", "default", "--iterations", "10"]
    monkeypatch.setattr("sys.argv", ["published", str(tmp_path / "sets"), *options])
    published.main()
    rows = json.loads((tmp_path / "published.json").read_text())
    assert set(rows) == {"3d_ovs bed", "lerf_ovs teatime", "lerf_mask figurines", "mip_nerf_360 garden"}
    said = capsys.readouterr().out
    for name, row in rows.items():
        data_set, scene = name.split()
        for table in PAPER[data_set]:
            assert table.figure == "minutes" or row["figures"][table.figure] is not None, table.title
            assert f"{data_set}: {table.title}\n\n| scene | {' | '.join(table.methods)} | here |" in said
            assert f"| {scene} | {' | '.join(f'{value:.{table.digits}f}' for value in table.scenes[scene])} | " in said
    assert "not measured" not in said


def test_views_of_lerf_mask_count_those_that_are_not_trained_on(tmp_path: Path) -> None:
    dataset = read_dataset(made_data.lerf_mask(tmp_path / "ramen", 4, 2), CaptureSettings())
    assert dataset.kind == "lerf_mask" and len(dataset.train) == 4
    assert [view.name for view in dataset.test] == ["test_0.png", "test_1.png"]
    assert [int(view.queries[0].mask.sum()) for view in dataset.test] == [300, 320]
    assert [query.text for query in dataset.test[0].queries] == ["green spoon", "red mug"]


def test_cameras_of_llff_are_those_of_the_same_scene_in_colmap(tmp_path: Path) -> None:
    folder = made_data.three_d_ovs(tmp_path / "bed", 6, ["01", "04"])
    wanted = read_dataset(with_transforms(folder, tmp_path / "work"), CaptureSettings())
    shutil.rmtree(made_data.with_poses_bounds(folder, made_data.poses(6)) / "sparse")
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
            published.fetch(archive.as_uri(), wrong, folder)
        assert not folder.exists()
    published.fetch(archive.as_uri(), digest, folder)
    assert published.scenes_in(folder) == {"bed": folder / "bed"}


def test_means_are_of_whole_sets_and_what_was_not_measured_is_called_so() -> None:
    figures = {"miou_views": 0.5, "localization": None}
    bed = {"figures": figures, "stage_seconds": {"training": 120.0}}
    alone = tables({("3d_ovs", "bed"): bed})
    assert "| bed | 0.925 | 0.643 | 0.933 | 0.500 |" in alone
    assert "| bed | 0.992 | 0.961 | 0.998 | not measured |" in alone
    assert "| bed | 79.23 | 107.25 | 13.96 | 2.00 |" in alone and "mean" not in alone and "lerf_ovs" not in alone
    desk = {"figures": {"miou_views": 0.7, "localization": 1.0}, "stage_seconds": {"training": 240.0}}
    whole = tables({("3d_ovs", "bed"): bed, ("3d_ovs", "covered_desk"): desk})
    assert "| mean | 0.852 | 0.661 | 0.923 | 0.600 |" in whole  # as the paper's own means
    assert "| mean | 0.985 | 0.928 | " in whole and whole.count("mean") == 2 and whole.count("not measured") == 2
