"""Whatever is wrong with some photos of a capture costs these photos: all others have a place, and each is named."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from benchmarks.robustness.spoiled_photos import DAMAGED, SETTINGS, SPOILED, capture_of, exif, jpeg
from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.sfm.mapping import take_out_impossible
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import ReconstructionError
from tests.capture.synthetic_views import synthesize_views
from tests.capture.upload_files import PINHOLE, captured, frames_of, points_file

_GOOD = range(0, 40, 3)


def _capture(folder: Path, names: list[str], test_data: Path, settings):
    """Of fourteen good photos and those with these faults; files that are damaged were whole when they were checked."""
    settings = settings.model_copy(update={"max_side": 480, "sfm_features": 2_000})
    sent = {f"{index:03d}.jpg": (test_data / f"tabletop/images/{index:03d}.jpg").read_bytes() for index in _GOOD}
    photos, damaged, rng = list(sent.values()), {}, np.random.default_rng(0)
    foreign = np.asarray(Image.open(test_data / "kitchen/images/05.jpg").convert("RGB"))
    for number, name in enumerate(names):
        content = photos[3 * number % len(photos)]
        if name in DAMAGED:
            damaged[f"{name}.jpg"] = DAMAGED[name](content)
        else:
            content = SPOILED[name](np.asarray(Image.open(io.BytesIO(content))), foreign, rng)
        sent[f"{name}.jpg"] = content
    return capture_of(folder, sent, damaged, settings)


@pytest.mark.parametrize(
    "names",
    [
        ["truncated", "black", "tiny", "foreign", "lying", "crop"],
        ["garbage", "text", "white", "duplicate", "rotated", "lens", "absurd", "huge"],
    ],
    ids=lambda names: names[0],
)
def test_spoiled_photos_cost_themselves_and_are_named(names: list[str], test_data: Path, tmp_path, settings) -> None:
    capture = _capture(tmp_path, names, test_data, settings)
    good, spoiled = {f"{index:03d}.jpg" for index in _GOOD}, {f"{name}.jpg" for name in names}
    placed = {view.posed.name for view in capture.views}
    assert good <= placed <= good | spoiled
    report = capture.report
    verdicts = {verdict.name: verdict for verdict in report.photos}
    assert verdicts.keys() == good | spoiled and report.images == len(verdicts)
    assert set(report.unregistered) == verdicts.keys() - placed
    for name in spoiled - placed:
        assert verdicts[name].not_placed is not None and verdicts[name].advice.endswith(".")
    for name in good:
        assert verdicts[name].placed and set(verdicts[name].defects) <= {"duplicate"}  # of a spoiled copy
    reasons = {name.removesuffix(".jpg"): verdict.not_placed for name, verdict in verdicts.items()}
    assert {reasons[name] for name in DAMAGED.keys() & set(names)} == {"unreadable"}
    assert {reasons[name] for name in {"black", "white", "tiny"} & set(names)} == {"few_features"}
    assert {reasons[name] for name in {"foreign"} & set(names)} <= {"no_overlap", "few_matches", "other_model"}
    if "duplicate" in names:
        copied = f"{3 * names.index('duplicate') * 3 % 42:03d}.jpg"
        assert verdicts["duplicate.jpg"].duplicate_of == copied or verdicts[copied].duplicate_of == "duplicate.jpg"


def test_pieces_of_photos_whose_own_lens_runs_away_cost_themselves(test_data: Path, tmp_path: Path) -> None:
    """Two of some hundred that were tried: each gets a camera of its own, which bundle adjustment drives off."""
    paths = sorted((test_data / "plush/images").iterdir())
    chosen = [paths[row] for row in np.linspace(0, len(paths) - 1, 16).round().astype(int)]
    sent = {path.name: path.read_bytes() for path in chosen}
    for name, (rows, columns), focal in (
        ("20240212_004008.jpg", (slice(342, 750), slice(706, 1000)), 80.0),
        ("20240212_004010.jpg", (slice(369, 608), slice(726, 1000)), None),
    ):
        piece = np.ascontiguousarray(np.asarray(Image.open(test_data / "plush/images" / name))[rows, columns])
        sent[f"piece of {name}"] = jpeg(piece, exif=exif(focal)) if focal else jpeg(piece)
    capture = capture_of(tmp_path, sent, {}, SETTINGS)
    reasons = {verdict.name: verdict.not_placed for verdict in capture.report.photos if not verdict.placed}
    alone = {"20240212_004010.jpg", "20240212_004018.jpg"}  # without a place among the sixteen, too
    assert reasons.keys() <= alone | {name for name in sent if name.startswith("piece")}
    assert "lens" in reasons.values()


def test_photos_that_are_all_damaged_end_the_capture_with_a_reason(upload, photo, settings) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2)})
    files = validate_upload(folder, settings).folder / "files"
    for path in sorted(files.iterdir()):
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(content[:300])
    with pytest.raises(ReconstructionError, match="hardly one of 2 photos") as caught:
        build_capture(folder, folder.parent / "out", settings, silent)
    assert caught.value.hint and not (folder.parent / "out").exists()


def test_a_camera_of_the_upload_that_folds_the_picture_costs_its_photo(upload, photo, settings) -> None:
    frames = frames_of(f"{number}.jpg" for number in range(3))
    frames[1] |= {"fl_x": 40.0, "fl_y": 40.0, "k1": -0.9}
    document = json.dumps({**PINHOLE, "frames": frames}).encode()
    files = {f"{number}.jpg": photo(number) for number in range(3)}
    folder = upload({**files, "transforms.json": document, "points3d.ply": points_file((0, 0, -2))})
    capture = captured(folder, settings)
    assert [view.posed.name for view in capture.views] == ["0.jpg", "2.jpg"]
    assert capture.report.unregistered == ("1.jpg",) and capture.report.images == 3
    assert [verdict.not_placed for verdict in capture.report.photos] == [None, "lens", None]


def _runaway(image: pycolmap.Image) -> None:
    camera = image.camera
    camera.width, camera.height = 219, 463
    camera.params = np.array([365.67, 109.5, 231.5, -0.5187])  # as bundle adjustment left it once


def _lens_of(*params: float) -> Callable[[pycolmap.Image], None]:
    def change(image: pycolmap.Image) -> None:
        image.camera.params = np.array(params)

    return change


def _lost(image: pycolmap.Image) -> None:
    pose = np.array(image.frame.rig_from_world.matrix())
    pose[1, 3] = np.nan
    image.frame.rig_from_world = pycolmap.Rigid3d(pose)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (_runaway, "lens"),
        (_lens_of(90_000.0, 512, 384, 0.0), "lens"),
        (_lens_of(90.0, 512, 384, 0.0), "lens"),
        (_lens_of(np.nan, 512, 384, 0.0), "lens"),
        (_lens_of(1280.0, 512, 384, np.inf), "lens"),
        (_lens_of(1280.0, -9e9, 384, 0.0), "lens"),
        (_lost, "unknown"),
    ],
)
def test_an_impossible_camera_leaves_with_its_observations_and_no_other(tmp_path: Path, spoil, reason: str) -> None:
    model = synthesize_views(tmp_path / "features.db", 8, 60, cameras=8)
    spoiled = model.images[3]
    before = {image.name: image.cam_from_world().matrix() for image in model.images.values()}
    spoil(spoiled)
    assert take_out_impossible([model], 1600) == {spoiled.name: reason}
    after = {image.name: image.cam_from_world().matrix() for image in model.images.values() if image.has_pose}
    assert after.keys() == before.keys() - {spoiled.name}
    assert all(np.array_equal(after[name], before[name]) for name in after)
    seen_by = {element.image_id for point in model.points3D.values() for element in point.track.elements}
    assert model.num_points3D() > 50 and spoiled.image_id not in seen_by
    assert all(point.track.length() >= 2 for point in model.points3D.values())
    assert take_out_impossible([model], 1600) == {}
