"""Tiny data sets of every layout, whose truth is a scene of coloured balls that is known exactly."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.scenes import labelled_scene

LABELS = ("red mug", "green spoon", "blue bed")
CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
SETTINGS = QuerySettings(templates=("{}",), threshold=0.5, exact_threshold=0.95)
_COLOURS = np.array([[1.5, -1.5, -1.5], [-1.5, 1.5, -1.5], [-1.5, -1.5, 1.5]], np.float32)


class WordEncoder:
    """Every text has a direction of its own; "a b" lies near "b"."""

    name = "words"
    sha256 = "0" * 64

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        rows = [self._row(text) for text in texts]
        return np.stack(rows).astype(np.float32)

    @staticmethod
    def _row(text: str) -> NDArray[np.float64]:
        total = np.zeros(64)
        for word in text.lower().split():
            total += np.random.default_rng(list(word.encode())).standard_normal(64)
        return total / np.linalg.norm(total)


def scene(labels: Sequence[str] = LABELS, cameras: tuple[PosedCamera, ...] = ()) -> Scene:
    """Three opaque balls in a row along x at z = 2, one a label."""
    return labelled_scene(
        [[-0.7, 0, 2], [0, 0, 2], [0.7, 0, 2]],
        [1, 2, 3],
        labels,
        sh=_COLOURS[:, None],
        undetected_bias=4.0,
        encoder=WordEncoder(),
        cameras=cameras,
    )


def poses(count: int) -> list[NDArray[np.float64]]:
    """world_from_camera, side by side, all looking along +z."""
    matrices = []
    for index in range(count):
        pose = np.eye(4)
        pose[0, 3] = 0.05 * (index - count // 2)
        matrices.append(pose)
    return matrices


def index(custom_scene: Scene | None = None) -> SceneIndex:
    return SceneIndex(custom_scene or scene(), WordEncoder(), SETTINGS)


def picture(seed: int) -> NDArray[np.uint8]:
    """uint8 [H, W, 3] of no particular content."""
    return np.random.default_rng(seed).integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)


def save(pixels: NDArray[np.generic], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def change_json(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Changes what a JSON file says."""
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def nerfstudio(folder: Path, count: int = 6, test: Sequence[int] = (1, 4), *, drop: Sequence[str] = ()) -> Path:
    """Images, label maps, depth maps, points and a split: all rendered from `scene`."""
    truth = index()
    frames = []
    for number, pose in enumerate(poses(count)):
        posed = PosedCamera(CAMERA, pose)
        save(truth.render(posed), folder / f"images/{number:03d}.png")
        save(truth.label_map(posed).astype(np.uint8), folder / f"masks/{number:03d}.png")
        save((truth.depth(posed) * 1e3).round().astype(np.uint16), folder / f"depth/{number:03d}.png")
        opengl = pose.copy()
        opengl[:3, 1:3] *= -1
        frame = {
            "file_path": f"images/{number:03d}.png",
            "mask_path": f"masks/{number:03d}.png",
            "depth_path": f"depth/{number:03d}.png",
            "transform_matrix": opengl.tolist(),
        }
        frames.append({key: value for key, value in frame.items() if key not in drop})
    document = {
        "w": CAMERA.width, "h": CAMERA.height, "fl_x": CAMERA.fx, "fl_y": CAMERA.fy, "cx": CAMERA.cx, "cy": CAMERA.cy,
        "labels": {name: number for number, name in enumerate(LABELS, 1)},
        "depth_unit": "1e-3 m, planar z",
        "convention": "OpenGL, meters",
        "frames": frames,
        "split": {
            "train": [f"{i:03d}" for i in range(count) if i not in test],
            "test": [f"{i:03d}" for i in test],
        },
    }  # fmt: skip
    entries = {key: value for key, value in document.items() if key not in drop}
    (folder / "transforms.json").write_text(json.dumps(entries))
    (folder / "points3d.ply").write_text(_ply(scene().gaussians.means))
    return folder


def colmap(folder: Path, stems: Sequence[str]) -> Path:
    """`images/<stem>.png` and a text model of one pinhole camera."""
    lines = []
    for number, (stem, pose) in enumerate(zip(stems, poses(len(stems)), strict=True), 1):
        save(picture(number), folder / f"images/{stem}.png")
        x = -pose[0, 3]
        lines += [f"{number} 1 0 0 0 {x} 0 0 1 {stem}.png", ""]
    model = folder / "sparse/0"
    model.mkdir(parents=True)
    size = f"{CAMERA.width} {CAMERA.height} {CAMERA.fx} {CAMERA.fy} {CAMERA.cx} {CAMERA.cy}"
    (model / "cameras.txt").write_text(f"1 PINHOLE {size}\n")
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    points = [f"{i} {x} {y} {z} 200 100 50 0.5" for i, (x, y, z) in enumerate(scene().gaussians.means, 1)]
    (model / "points3D.txt").write_text("\n".join(points) + "\n")
    return folder


def lerf_ovs(root: Path, frames: Sequence[int], annotated: Sequence[int], *, labelme: bool = False) -> Path:
    """`root/teatime` and `root/label/teatime`; images `frame_00041.png` and so on."""
    folder = colmap(root / "teatime", [f"frame_{number:05d}" for number in frames])
    labels = root / "label" / "teatime"
    labels.mkdir(parents=True)
    for number in annotated:
        left, right = [[4, 4], [20, 4], [20, 30], [4, 30]], [[40, 10], [60, 10], [60, 40]]
        parts = [("red mug", left), ("green spoon", right), ("red mug", [[30, 2], [34, 2], [34, 6], [30, 6]])]
        if labelme:
            document = {
                "imageWidth": CAMERA.width, "imageHeight": CAMERA.height,
                "shapes": [{"label": text, "points": points, "shape_type": "polygon"} for text, points in parts],
            }  # fmt: skip
        else:
            document = {
                "info": {"name": f"frame_{number:05d}.jpg", "width": CAMERA.width, "height": CAMERA.height},
                "objects": [{"category": t, "segmentation": p, "bbox": [0, 0, 1, 1]} for t, p in parts],
            }
        (labels / f"frame_{number:05d}.json").write_text(json.dumps(document))
    return folder


def three_d_ovs(folder: Path, count: int, annotated: Sequence[str], *, stems: Sequence[str] = ()) -> Path:
    """`segmentations/<frame>/<label>.png`, the last label unseen; images are 00.png and so on, or `stems`."""
    colmap(folder, stems or [f"{number:02d}" for number in range(count)])
    (folder / "segmentations").mkdir()
    (folder / "segmentations/classes.txt").write_text("\n".join(LABELS) + "\n\n")
    for frame in annotated:
        for number, label in enumerate(LABELS):
            mask = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
            mask[10:30, 5 + 20 * number : 20 + 20 * number] = 255 * (number < 2)
            save(mask, folder / f"segmentations/{frame}/{label}.png")
    return folder


def lerf_mask(folder: Path, train: int, tests: int) -> Path:
    """`test_mask/<position>/<text>.png`, of images that are not in `images_train`, and the folders beside these."""
    colmap(folder, [*(f"frame_{number:05d}" for number in range(1, train + 1)), *(f"test_{i}" for i in range(tests))])
    for image in (folder / "images").glob("frame_*"):
        save(np.zeros((CAMERA.height, CAMERA.width), np.uint8), folder / "object_mask" / image.name)
        (folder / "images_train").mkdir(exist_ok=True)
        (folder / "images_train" / image.name).write_bytes(image.read_bytes())
    for position in range(tests):
        for number, label in enumerate(LABELS[:2]):
            mask = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
            mask[10:30, 5 + 20 * number : 20 + 20 * number + position] = 255
            save(mask, folder / f"test_mask/{position}/{label}.png")
    return folder


def mip_nerf_360(folder: Path, count: int) -> Path:
    """`images`, its reduced copies `images_2` and so on, a binary model and `poses_bounds.npy`."""
    colmap(folder, [f"DSC{number:05d}" for number in range(count)])
    model = pycolmap.Reconstruction(folder / "sparse/0")
    for text in (folder / "sparse/0").iterdir():
        text.unlink()
    model.write_binary(folder / "sparse/0")
    for image in (folder / "images").iterdir():
        for factor in (2, 4, 8):
            save(np.asarray(Image.open(image).reduce(factor)), folder / f"images_{factor}" / image.name)
    return with_poses_bounds(folder, poses(count))


def with_poses_bounds(folder: Path, matrices: Sequence[NDArray[np.float64]], camera: Camera = CAMERA) -> Path:
    """The cameras in LLFF's file: columns down, right, backward, position, and the picture's size and focal length."""
    rows = []
    for pose in matrices:
        right, down, forward, position = pose[:3].T
        matrix = np.stack([down, right, -forward, position, [camera.height, camera.width, camera.fx]], axis=1)
        rows.append([*matrix.ravel(), 0.5, 9.0])
    np.save(folder / "poses_bounds.npy", rows)
    return folder


def same_truth(root: Path, test: Sequence[int] = (1, 4)) -> tuple[Path, Path, Path]:
    """One truth in three layouts: label maps, one mask a label (3D-OVS), polygons (LERF-OVS); the same test views."""
    maps = nerfstudio(root / "maps", 6, test)
    truth = index()
    stems = [f"frame_{number:05d}" for number in range(6)]
    masks, polygons = colmap(root / "masks", stems), colmap(root / "polygons", stems)
    (masks / "segmentations").mkdir()
    (masks / "segmentations/classes.txt").write_text("\n".join(LABELS))
    (polygons / "label").mkdir()
    for number in test:
        label_map = truth.label_map(PosedCamera(CAMERA, poses(6)[number]))
        objects = []
        for label_id, label in enumerate(LABELS, 1):
            mask = (label_map == label_id).astype(np.uint8)
            save(mask * 255, masks / f"segmentations/{stems[number]}/{label}.png")
            outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            outline = (outlines[0][:, 0] + 0.5).tolist()  # centres of the outermost pixels
            objects.append({"category": label, "segmentation": outline, "bbox": [0, 0, 1, 1]})
        info = {"name": f"{stems[number]}.jpg", "width": CAMERA.width, "height": CAMERA.height}
        (polygons / f"label/{stems[number]}.json").write_text(json.dumps({"info": info, "objects": objects}))
    return maps, masks, polygons


def _ply(points: NDArray[np.float32]) -> str:
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    return "\n".join([*head, "end_header", *(f"{x} {y} {z} 200 100 50" for x, y, z in points)]) + "\n"
