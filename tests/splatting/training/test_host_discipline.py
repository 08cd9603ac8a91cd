"""Backend `cuda` mixes no tensors of host and device; the device is none, see `tests/splatting/pretend_gpu.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import silent
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.scene_objects import find_scene_objects
from fastsplat.service.localization.landmarks import find_landmarks
from fastsplat.service.localization.photo_placement import Photo, place_photos
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.measures.locating import locate
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_views import surface_views
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.splat_import.bulk import find_bulk
from fastsplat.service.splat_import.label_lifting import lift_labels
from fastsplat.service.splat_import.pictures import Painter
from fastsplat.service.splat_import.splat_import_settings import SplatImportSettings
from fastsplat.service.splat_import.viewpoints import choose_viewpoints, trial_camera
from fastsplat.service.splatting.raster import cuda
from fastsplat.service.splatting.training import requirement
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.object_prompts import Pixel
from fastsplat_contract.geometry.places import Place
from tests.instances.made_room import NAMES, ColorSegmenter, NoDetector, make_room
from tests.localization.textured_room import looking, textured_room
from tests.query.box_scenes import orbit, scene_of
from tests.query.conftest import DrawnEncoder
from tests.query.objects.test_picking import BOOK, CUP, FRONT, MUG, scene_with
from tests.splat_import.test_lifting import classes_of, labelling_of, with_splat
from tests.splatting import pretend_gpu


@pytest.fixture
def device(gsplat_on_cpu: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The device of backend `cuda`."""
    monkeypatch.setattr(cuda, "DEVICE", pretend_gpu.DEVICE)
    with pretend_gpu.pretended():
        yield pretend_gpu.DEVICE


def test_the_device_is_as_strict_as_a_gpu(device: str) -> None:
    there, here = torch.arange(4.0, device=device), torch.arange(4.0)
    assert there.device.type == device and there.cpu().tolist() == here.tolist() == there.tolist()
    with pytest.raises(RuntimeError, match="numpy"):
        there.numpy()
    with pytest.raises(RuntimeError, match="numpy"):
        np.asarray(there)
    with pytest.raises(RuntimeError, match="same device"):
        there + here
    with pytest.raises(RuntimeError, match="same device"):
        torch.stack([there, here])
    assert (there * torch.tensor(2.0)).cpu().tolist() == [0.0, 2.0, 4.0, 6.0]
    assert there[torch.tensor([1, 3])].cpu().tolist() == [1.0, 3.0]
    weight = torch.ones(4, device=device, requires_grad=True)
    (weight * there).square().sum().backward()
    assert weight.grad is not None and weight.grad.cpu().tolist() == [0.0, 2.0, 8.0, 18.0]


@pytest.mark.parametrize("changes", [{"tolerance_db": 0.1}, {"label_mode": "evidence"}, {"photometric": "on"}])
def test_training(world, quick, device: str, changes: dict[str, Any], tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(requirement, "FEWEST_STEPS", 2)
    settings = quick(iterations=6, max_gaussians=120, backend="cuda", checkpoint_every_s=0.0, evaluations=2, **changes)
    found = train(*world, settings, silent, tmp_path)
    assert np.isfinite(found.quality["loss"]) and isinstance(found.gaussians.means, np.ndarray)


def test_discovery_and_codes_of_objects(device: str, tmp_path: Path) -> None:
    room = make_room(tmp_path, views=4)
    perception = PerceptionSettings(min_pixels=8, closer_look=False)
    masks = propose_view_masks(room.capture.views, NoDetector(), ColorSegmenter(), perception)
    labelling = Labelling(dictionary_of(NAMES), room.maps, exact=True)
    found = {}
    for backend in ("cpu", "cuda"):
        training = TrainingSettings(backend=backend, max_side=64)
        settings = DiscoverySettings(min_weight_px=5)
        found[backend] = find_scene_objects(room.gaussians, room.capture, labelling, masks, settings, training=training)
    (ours, _), (theirs, coded) = found["cpu"], found["cuda"]
    assert [obj.id for obj in theirs.table] == [obj.id for obj in ours.table] and len(ours.table) > 2
    assert [obj.name for obj in theirs.table] == [obj.name for obj in ours.table]
    assert np.mean(object_rows(theirs) == object_rows(ours)) > 0.99 and isinstance(coded.codes, np.ndarray)


def test_questions_pictures_and_places(device: str) -> None:
    index = {
        backend: SceneIndex(scene_with(), DrawnEncoder(), QuerySettings(templates=("{}",), backend=backend))
        for backend in ("cpu", "cuda")
    }
    rows, columns = np.nonzero(index["cpu"].objects.map(FRONT) == MUG)
    middle = Pixel(float(np.median(columns)) + 0.5, float(np.median(rows)) + 0.5)
    renderer = {backend: Renderer(scene_index.scene, scene_index.settings) for backend, scene_index in index.items()}
    labelled = {
        backend: Renderer(scene_of([CUP, BOOK], orbit()), scene_index.settings)
        for backend, scene_index in index.items()
    }
    calls: dict[str, Callable[[str], Any]] = {
        "colors": lambda backend: renderer[backend].colors(FRONT),
        "depth": lambda backend: renderer[backend].depth(FRONT),
        "normals": lambda backend: renderer[backend].geometry(FRONT).normals,
        "labels": lambda backend: labelled[backend].label_map(FRONT),
        "mask": lambda backend: labelled[backend].mask(FRONT, (1,), np.array([0, 1, 0], np.float32)).mask,
        "objects": lambda backend: index[backend].objects.map(FRONT),
        "parts": lambda backend: index[backend].objects.part_map(FRONT),
        "place": lambda backend: locate(index[backend], Place(pixel=middle, camera=FRONT)).point,
        "surfaces": lambda backend: surface_views(index[backend])[0].objects,
    }
    for what, ask in calls.items():
        ours, theirs = (np.asarray(ask(backend), float) for backend in ("cpu", "cuda"))
        assert ours.shape == theirs.shape and ours.size, what
        assert np.quantile(np.abs(ours - theirs), 0.98) <= 1e-3 + 1e-3 * np.abs(ours).max(), what


def test_a_photo_finds_its_place(device: str) -> None:
    room, found = textured_room(cameras=3), {}
    for backend in ("cpu", "cuda"):
        drawn = Renderer(room, QuerySettings(backend=backend))
        photos = [(posed, lambda posed=posed, drawn=drawn: drawn.colors(posed)) for posed in room.cameras]
        landmarks = find_landmarks(photos, drawn.geometry)
        (placed,) = place_photos([Photo(drawn.colors(looking(0.11)), None)], landmarks, drawn.geometry)
        assert placed.posed is not None
        found[backend] = placed.posed.world_from_camera
    assert np.abs(found["cpu"] - found["cuda"]).max() < 0.02


@pytest.mark.parametrize("mode", ["auto", "evidence"])
def test_labels_fused_onto_an_imported_splat(device: str, tmp_path: Path, mode: str) -> None:
    room, found = make_room(tmp_path, views=4), {}
    for backend in ("cpu", "cuda"):
        training = TrainingSettings(backend=backend, label_mode=mode, max_side=64)
        steps = SplatImportSettings(code_steps=6)
        found[backend] = lift_labels(with_splat(room, tmp_path), labelling_of(room), training, steps, silent)
    ours, theirs = found["cpu"], found["cuda"]
    assert np.mean(classes_of(ours) == classes_of(theirs)) > 0.97 and len(np.unique(classes_of(ours))) > 2
    assert theirs.quality.get("psnr", 0.0) == pytest.approx(ours.quality.get("psnr", 0.0), abs=0.1)


def test_viewpoints_and_pictures_of_a_splat_without_photos(device: str, tmp_path: Path) -> None:
    room = make_room(tmp_path, views=4)
    bulk, up, camera = find_bulk(room.gaussians), np.array([0.0, 0.0, 1.0]), trial_camera(60.0)
    ours, theirs = (
        choose_viewpoints(room.gaussians, bulk, up, 2, 60.0, backend=backend) for backend in ("cpu", "cuda")
    )
    assert len(ours) == len(theirs) > 0
    posed = PosedCamera(camera, ours[0], "picture")
    drawn = [Painter(room.gaussians, backend).picture(posed)[0].astype(int) for backend in ("cpu", "cuda")]
    assert np.quantile(np.abs(drawn[0] - drawn[1]), 0.98) <= 2 and drawn[0].any()
