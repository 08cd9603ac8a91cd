"""Every layout is read as its makers meant it, split cleanly, and refused with a reason when it is broken."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.datasets.training import training_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError, NotFoundError
from tests.benchmarks.evaluation import made_data

SETTINGS = CaptureSettings()


def _trained_on(dataset: Dataset, work: Path) -> set[str]:
    return {view.posed.name for view in training_capture(dataset, work, SETTINGS, silent).views}


def test_a_transforms_json_says_everything_itself(tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made")
    before = sorted(path.name for path in folder.rglob("*"))
    dataset = read_dataset(folder, SETTINGS)
    assert dataset.kind == "nerfstudio"
    assert [view.name for view in dataset.test] == ["images/001.png", "images/004.png"]
    assert [entry.label for entry in dataset.dictionary.entries] == list(made_data.LABELS)
    view = dataset.test[1]
    assert view.posed.camera == made_data.CAMERA
    assert view.posed.world_from_camera == pytest.approx(made_data.poses(6)[4])
    truth = made_data.index()
    assert (view.rgb == truth.render(view.posed)).all()
    assert (view.labels == truth.label_map(view.posed)).all() and view.labels.max() == 3
    assert view.depth == pytest.approx(truth.depth(view.posed), abs=1e-3) and view.depth.max() > 1
    capture = training_capture(dataset, tmp_path / "work", SETTINGS, silent)
    assert [view.posed.name for view in capture.views] == [f"images/{i:03d}.png" for i in (0, 2, 3, 5)]
    assert len(capture.points) == 3 and len(capture.given_labels.map_paths) == 4 and capture.test_names == ()
    assert before == sorted(path.name for path in folder.rglob("*"))


def test_a_training_list_leaves_the_rest_out(tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made")
    made_data.change_json(folder / "transforms.json", lambda d: d["split"].update(train=["000", "images/002.png"]))
    dataset = read_dataset(folder, SETTINGS)
    assert dataset.train == ("images/000.png", "images/002.png")
    made_data.change_json(folder / "transforms.json", lambda d: d["split"].update(train=["000", "001"]))
    with pytest.raises(InvalidInputError, match=r"001.* training and in the test"):
        read_dataset(folder, SETTINGS)


def test_without_a_split_every_eighth_view_tests(tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made", 18, drop=("split",))
    dataset = read_dataset(folder, SETTINGS)
    assert [view.name[-7:-4] for view in dataset.test] == ["000", "008", "016"]
    assert len(dataset.train) == 15
    assert len(read_dataset(folder, SETTINGS, test_every=2).test) == 9
    with pytest.raises(InvalidInputError, match="testing"):
        read_dataset(folder, SETTINGS, test_every=1)


def test_binary_masks_get_the_name_they_are_given_and_else_say_what_counts(tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made", drop=("labels",))
    for path in (folder / "masks").iterdir():
        with Image.open(path) as image:
            mask = np.asarray(image) > 0
        made_data.save(mask.astype(np.uint8) * 255, path)
    ignored = read_dataset(folder, SETTINGS)
    assert len(ignored.dictionary) == 0 and ignored.test[0].labels is None
    assert 0 < ignored.test[0].valid.mean() < 1
    named = read_dataset(folder, SETTINGS, mask_label="balls")
    assert named.test[0].valid is None and set(np.unique(named.test[0].labels)) == {0, 1}
    assert (named.test[0].labels > 0).mean() == ignored.test[0].valid.mean()
    capture = training_capture(named, tmp_path / "work", SETTINGS, silent)
    assert [entry.label for entry in capture.given_labels.dictionary.entries] == ["balls"]
    with Image.open(capture.given_labels.map_paths[0]) as image:
        assert set(np.unique(np.asarray(image))) == {0, 1}
    with pytest.raises(InvalidInputError, match="itself"):
        read_dataset(made_data.nerfstudio(tmp_path / "other"), SETTINGS, mask_label="balls")


def test_a_colmap_folder_may_have_labels_or_masks_or_neither(tmp_path: Path) -> None:
    stems = [f"p{number}" for number in range(9)]
    folder = made_data.colmap(tmp_path / "plain", stems)
    plain = read_dataset(folder, SETTINGS)
    assert plain.kind == "colmap" and len(plain.dictionary) == 0
    assert [view.name for view in plain.test] == ["p0.png", "p8.png"]
    assert _trained_on(plain, tmp_path / "a") == {f"p{number}.png" for number in range(1, 8)}
    half = np.zeros((48, 64), np.uint8)
    half[:, :32] = 255
    for stem in stems:
        made_data.save(half, folder / f"masks/{stem}.png")
    masked = read_dataset(folder, SETTINGS, mask_label="statue")
    assert masked.test[0].labels.mean() == 0.5
    capture = training_capture(masked, tmp_path / "b", SETTINGS, silent)
    assert len(capture.views) == 7 and all(capture.given_labels.map_paths)
    for stem in stems:
        made_data.save(half // 255 * 7, folder / f"labels/{stem}.png")
    (folder / "labels/labels.json").write_text('{"statue": 7}')
    labelled = read_dataset(folder, SETTINGS)
    assert (labelled.test[0].labels == masked.test[0].labels).all()
    assert training_capture(labelled, tmp_path / "c", SETTINGS, silent).given_labels is not None


def test_the_truth_is_undistorted_and_reduced_exactly_as_training_views_are(tmp_path: Path) -> None:
    folder = made_data.colmap(tmp_path / "bent", [f"p{number}" for number in range(4)])
    (folder / "sparse/0/cameras.txt").write_text("1 SIMPLE_RADIAL 64 48 50 32 24 0.2\n")
    coarse = np.random.default_rng(0).integers(0, 3, (6, 8)).astype(np.uint8)
    for number in range(4):
        made_data.save(np.kron(coarse, np.ones((8, 8), np.uint8)), folder / f"labels/p{number}.png")
    (folder / "labels/labels.json").write_text('["mug", "bed"]')
    settings = SETTINGS.model_copy(update={"max_side": 48})
    tested = read_dataset(folder, settings, test_every=2)
    trained = training_capture(read_dataset(folder, settings, test_every=3), tmp_path / "work", settings, silent)
    view, twin = tested.test[1], trained.views[1]
    assert view.name == twin.posed.name == "p2.png" and view.posed.camera == twin.posed.camera
    assert view.posed.camera.width < 48  # reduced, and cut where the distorted image ends
    with Image.open(twin.image_path) as image, Image.open(trained.given_labels.map_paths[1]) as label_map:
        assert (np.asarray(image) == view.rgb).all() and (np.asarray(label_map) == view.labels).all()
    assert set(np.unique(view.labels)) == {0, 1, 2}


@pytest.mark.parametrize("labelme", [False, True])
def test_lerf_annotations_are_found_by_the_frames_name_not_by_position(tmp_path: Path, labelme: bool) -> None:
    folder = made_data.lerf_ovs(tmp_path, [2, 41, 105, 140], [41, 140], labelme=labelme)
    dataset = read_dataset(folder, SETTINGS)
    assert dataset.kind == "lerf_ovs"
    assert [view.name for view in dataset.test] == ["frame_00041.png", "frame_00140.png"]
    with Image.open(folder / "images/frame_00041.png") as image:
        assert (np.asarray(image) == dataset.test[0].rgb).all()
    assert dataset.test[0].posed.world_from_camera[0, 3] == pytest.approx(made_data.poses(4)[1][0, 3])
    assert _trained_on(dataset, tmp_path / "work") == {"frame_00002.png", "frame_00105.png"}
    queries = {query.text: query for query in dataset.test[0].queries}
    assert set(queries) == {"red mug", "green spoon"}
    mug = queries["red mug"]
    assert len(mug.boxes) == 2 and mug.mask[10, 10] and mug.mask[4, 32] and not mug.mask[20, 30]
    assert mug.boxes[0] == pytest.approx((4, 4, 20, 30), abs=1)


def test_an_annotated_frame_without_a_pose_stays_and_is_missing(tmp_path: Path) -> None:
    folder = made_data.lerf_ovs(tmp_path, [1, 2, 3], [2, 9])
    dataset = read_dataset(folder, SETTINGS)
    lost = dataset.test[1]
    assert lost.name == "frame_00009" and lost.posed is None and len(lost.queries) == 2
    assert "frame_00009" in dataset.notes[0]


def test_3d_ovs_masks_belong_to_the_image_of_their_folders_name(tmp_path: Path) -> None:
    folder = made_data.three_d_ovs(tmp_path / "bed", 5, ["01", "04"])
    dataset = read_dataset(folder, SETTINGS)
    assert dataset.kind == "3d_ovs"
    assert [view.name for view in dataset.test] == ["01.png", "04.png"]
    assert [entry.label for entry in dataset.dictionary.entries] == list(made_data.LABELS)
    assert [query.text for query in dataset.test[0].queries] == list(made_data.LABELS[:2])  # the third is unseen
    assert dataset.test[0].queries[0].boxes == ((5, 10, 20, 30),)
    assert _trained_on(dataset, tmp_path / "work") == {"00.png", "02.png", "03.png"}


def test_3d_ovs_masks_of_no_class_are_left_out_with_a_note_as_public_loaders_do(tmp_path: Path) -> None:
    folder = made_data.three_d_ovs(tmp_path / "bed", 3, ["01"])
    plain = read_dataset(folder, SETTINGS)
    made_data.save(np.full((48, 64), 255, np.uint8), folder / "segmentations/01/sofa.png")
    dataset = read_dataset(folder, SETTINGS)
    assert [query.text for query in dataset.test[0].queries] == [query.text for query in plain.test[0].queries]
    assert "sofa" in dataset.notes[0] and not plain.notes


@pytest.mark.parametrize("frames", [["1", "3"], ["01", "03"], ["1", "4"]])
def test_3d_ovs_frames_count_images_where_no_image_has_their_name(tmp_path: Path, frames: list[str]) -> None:
    """Those beyond the images are missing."""
    folder = made_data.three_d_ovs(tmp_path / "bed", 4, frames, stems=["IMG_9", "a", "b", "c"])
    dataset = read_dataset(folder, SETTINGS)
    posed, missing = (["a.png", "c.png"], []) if "4" not in frames else (["a.png"], ["4"])
    assert [view.name for view in dataset.test if view.posed is not None] == posed
    assert [view.name for view in dataset.test if view.posed is None] == missing and len(dataset.notes) == len(missing)
    assert _trained_on(dataset, tmp_path / "work") == {"IMG_9.png", "a.png", "b.png", "c.png"} - set(posed)


def _edit(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], Path]:
    def broken(root: Path) -> Path:
        folder = made_data.lerf_ovs(root, [1, 2, 3], [2])
        made_data.change_json(root / "label/teatime/frame_00002.json", change)
        return folder

    return broken


def _three(change: Callable[[Path], object]) -> Callable[[Path], Path]:
    def broken(root: Path) -> Path:
        folder = made_data.three_d_ovs(root / "set", 4, ["01"])
        change(folder / "segmentations")
        return folder

    return broken


def _with_document(**entries: object) -> Callable[[Path], Path]:
    def broken(root: Path) -> Path:
        folder = made_data.nerfstudio(root / "set")
        made_data.change_json(folder / "transforms.json", lambda document: document.update(entries))
        return folder

    return broken


_MASK = "01/red mug.png"
BROKEN: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "no folder": ("nowhere", lambda root: root / "nowhere"),
    "nothing in it": ("no images", lambda root: root),
    "no object": ("frame_00002", _edit(lambda d: d.clear())),
    "huge frame": ("pixels", _edit(lambda d: d["info"].update(width=10**6, height=10**6))),
    "no width": ("width", _edit(lambda d: d["info"].update(width="wide"))),
    "other aspect": ("aspect", _edit(lambda d: d["info"].update(width=640, height=64))),
    "no category": ("category", _edit(lambda d: d["objects"][0].update(category=""))),
    "two points": ("polygon", _edit(lambda d: d["objects"][0].update(segmentation=[[0, 0], [1, 1]]))),
    "infinite": ("polygon", _edit(lambda d: d["objects"][0].update(segmentation=[[0, 0], [1, 1], [float("inf"), 2]]))),
    "a circle": ("circle", _edit(lambda d: d["objects"][0].update(shape_type="circle"))),
    "no objects at all": ("annotated", _edit(lambda d: d.update(objects=[]))),
    "a class without mask": ("red mug", _three(lambda f: (f / _MASK).unlink())),
    "another image's name": ("another image", _edit(lambda d: d["info"].update(name="frame_00003.jpg"))),
    "no name at all": ("another image", _edit(lambda d: d["info"].update(name=["frame_00002"]))),
    "a class that is twice": ("twice", _three(lambda f: (f / "classes.txt").write_text("red mug\nred mug \n"))),
    "a class beyond the folder": ("no mask", _three(lambda f: (f / "classes.txt").write_text("../../images/00\n"))),
    "no classes": ("classes.txt", _three(lambda f: (f / "classes.txt").write_text("\n"))),
    "a broken mask": ("red mug", _three(lambda f: (f / _MASK).write_bytes(b"\x89PNG\r\n"))),
    "a cropped mask": ("aspect", _three(lambda f: made_data.save(np.full((48, 20), 255, np.uint8), f / _MASK))),
    "an odd depth unit": ("depth", _with_document(depth_unit="a thumb's breadth")),
    "a negative depth unit": ("depth", _with_document(depth_unit=-1)),
    "an unknown test view": ("099", _with_document(split={"test": ["099"]})),
    "an unknown training view": ("099", _with_document(split={"train": ["099"], "test": ["001"]})),
    "ids without names": ("ids without a name", _with_document(labels={"red mug": 1})),
}
_KINDS = {"no folder": NotFoundError, "huge frame": LimitExceededError, "a broken mask": CorruptImageError}
"""Of errors that are not just an invalid input."""


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_data_set_is_refused_with_a_reason(tmp_path: Path, case: str) -> None:
    said, make = BROKEN[case]
    folder = make(tmp_path)
    with pytest.raises(_KINDS.get(case, InvalidInputError)) as caught:
        read_dataset(folder, SETTINGS)
    error = caught.value
    assert said in f"{error.message} {error.field} {error.limit}" and error.hint


def test_a_split_without_a_test_view_is_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="no test views"):
        Dataset(tmp_path, "colmap", Dictionary(()), ("a.png",), ())


def test_objects_of_one_label_are_told_apart_where_the_folder_does(tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "d")
    assert read_dataset(folder, SETTINGS).test[0].instances is None
    ids = np.random.default_rng(0).integers(0, 4, (48, 64)).astype(np.uint8)
    made_data.save(ids, folder / "instances/all.png")

    def tell_apart(instances: object) -> None:
        made_data.change_json(
            folder / "transforms.json",
            lambda d: d.update(
                instances=instances, frames=[{**frame, "instance_path": "instances/all.png"} for frame in d["frames"]]
            ),
        )

    tell_apart(["red mug", "red mug", "blue bed"])
    dataset = read_dataset(folder, SETTINGS)
    assert dataset.instances == ("red mug", "red mug", "blue bed")
    assert all((view.instances == ids).all() for view in dataset.test)
    for instances, said in ((["red mug"], "the object 3 of 1"), ("red mug", "no list")):
        tell_apart(instances)
        with pytest.raises(InvalidInputError, match=said):
            read_dataset(folder, SETTINGS)
