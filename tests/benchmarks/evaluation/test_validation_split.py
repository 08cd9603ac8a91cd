"""Settings are chosen on views that lie among the training views, and never on a test view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.datasets.training import training_capture
from benchmarks.evaluation.validation_split import validation_names
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.poses import look_at
from tests.benchmarks.evaluation import made_data

SETTINGS = CaptureSettings()


def _ring(count: int, *, jitter: float = 0.1, seed: int = 0) -> list[NDArray[np.float64]]:
    """Cameras on a circle that look at its center, world_from_camera."""
    rng, poses = np.random.default_rng(seed), []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        center = np.array([np.cos(angle), np.sin(angle), 0.3]) + jitter * rng.standard_normal(3)
        poses.append(look_at(center, (0, 0, 0)))
    return poses


def _names(count: int) -> list[str]:
    return [f"{number:03d}.png" for number in range(count)]


@pytest.mark.parametrize(("count", "every"), [(4, 5), (5, 2), (32, 5), (40, 8), (7, 100)])
def test_one_view_in_so_many_is_set_apart_and_the_rest_is_trained_on(count: int, every: int) -> None:
    names = validation_names(_names(count), _ring(count), every=every)
    assert len(names) == len(set(names)) == max(1, count // every) < count
    assert set(names) <= set(_names(count)) and list(names) == sorted(names)


@pytest.mark.parametrize("seed", range(5))
def test_order_frame_and_unit_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names, poses = _names(30), _ring(30, seed=seed)
    expected = validation_names(names, poses)
    shuffled = rng.permutation(30)
    assert validation_names([names[i] for i in shuffled], [poses[i] for i in shuffled]) == expected
    moved = np.eye(4)
    moved[:3, :3] = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    moved[:3, :3] *= np.sign(np.linalg.det(moved[:3, :3]))
    moved[:3, 3] = rng.uniform(-9, 9, 3)
    moved_poses = [moved @ pose for pose in poses]
    for pose in moved_poses:
        pose[:3, 3] *= 37.0
    assert validation_names(names, moved_poses) == expected


def test_validation_views_are_spread_over_the_path_and_lie_inside_it() -> None:
    """On an arc no stretch is without one, and its two ends are not among them."""
    poses = _ring(60, jitter=0)[:30]
    rows = [_names(30).index(name) for name in validation_names(_names(30), poses)]
    gaps = np.diff([-1, *rows, 30])
    assert len(rows) == 6 and gaps.max() <= 8 and rows[0] > 0 and rows[-1] < 29


def test_views_that_cannot_be_split_are_refused() -> None:
    for names, poses in ((_names(3), _ring(3)), (["a", "a", "b", "c"], _ring(4)), (_names(5), _ring(4))):
        with pytest.raises(InvalidInputError, match="split"):
            validation_names(names, poses)
    with pytest.raises(InvalidInputError, match="every"):
        validation_names(_names(9), _ring(9), every=1)


@pytest.mark.parametrize("train", [{}, {"train": ["000", "002", "003", "005", "006"]}])
def test_a_data_set_read_for_validation_never_touches_its_test_views(
    tmp_path: Path, train: dict[str, list[str]]
) -> None:
    """Whether only the views for testing are listed or also those for training, not all of which need be."""
    folder, split = made_data.nerfstudio(tmp_path / "made", 12, (1, 4, 9)), {"test": ["001", "004", "009"], **train}
    made_data.change_json(folder / "transforms.json", lambda document: document.update(split=split))
    whole = read_dataset(folder, SETTINGS)
    for number in (1, 4, 9):
        for part in ("masks", "depth"):
            (folder / part / f"{number:03d}.png").write_bytes(b"not read")
    dataset = read_dataset(folder, SETTINGS, split="validation")
    measured = {view.name for view in dataset.test}
    assert measured and measured < set(whole.train) and measured | set(dataset.train) == set(whole.train)
    assert len(whole.train) == len(train.get("train", range(9)))
    assert (whole.split, dataset.split) == ("test", "validation")
    assert all(view.labels is not None and view.depth is not None for view in dataset.test)
    capture = training_capture(dataset, tmp_path / "work", SETTINGS, silent)
    assert {view.posed.name for view in capture.views} == set(dataset.train)


def test_annotated_sets_validate_on_pictures_of_frames_without_annotation(tmp_path: Path) -> None:
    folder = made_data.lerf_ovs(tmp_path, range(1, 9), [2, 5])
    dataset = read_dataset(folder, SETTINGS, split="validation")
    assert len(dataset.test) == 1 and len(dataset.train) == 5 and "pictures only" in dataset.notes[-1]
    assert not {"frame_00002.png", "frame_00005.png"} & {dataset.test[0].name, *dataset.train}
    assert dataset.test[0].queries == () and dataset.test[0].labels is None
