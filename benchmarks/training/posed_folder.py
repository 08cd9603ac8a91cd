"""A posed data set with perfect label maps, read without the service's capture room: nothing is resampled."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image
from plyfile import PlyData

from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.common.dictionary import Dictionary, dictionary_of
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.training_views import split_views
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_TEST_EVERY = 5


def load_posed_folder(root: Path) -> tuple[Capture, Labelling]:
    """`transforms.json` (one pinhole camera, OpenGL world-from-camera), `points3d.ply`, and id masks if there are.

    `test_names` of the capture are the test views of the document's `split`; without one every fifth view.
    """
    document = json.loads((root / "transforms.json").read_text())
    camera = Camera(*(document[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")))
    views, maps = [], []
    for frame in sorted(document["frames"], key=lambda frame: str(frame["file_path"])):
        pose = np.array(frame["transform_matrix"], np.float64)
        pose[:3, 1:3] *= -1  # OpenGL's y up, z backward to OpenCV's y down, z forward
        path = root / frame["file_path"]
        views.append(View(PosedCamera(camera, pose, path.name), path))
        if "mask_path" in frame:
            maps.append(np.asarray(Image.open(root / frame["mask_path"])).astype(np.uint16))
    vertices = PlyData.read(str(root / "points3d.ply"))["vertex"]
    stated = {Path(str(name)).stem for name in document.get("split", {}).get("test", ())}
    rows = split_views(len(views), _TEST_EVERY)[1]
    capture = Capture(
        views=tuple(views),
        points=np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float32),
        point_colors=np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1).astype(np.uint8),
        scale="METRIC",
        report=CaptureReport("nerfstudio", len(views)),
        test_names=tuple(
            view.posed.name
            for row, view in enumerate(views)
            if (view.image_path.stem in stated if stated else row in rows)
        ),
    )
    labels = sorted(document.get("labels", {}).items(), key=lambda item: item[1])
    dictionary = dictionary_of(name for name, _ in labels) if maps else Dictionary(())
    return capture, Labelling(dictionary, tuple(maps))
