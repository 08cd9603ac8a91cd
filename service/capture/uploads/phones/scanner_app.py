"""Reads frames exported by 3D Scanner App ("all data"): photos with ARKit's poses.

    frame_00000.json   "cameraPoseARFrame" (16 numbers, row by row), "intrinsics" (9 numbers, row by row)
    frame_00000.jpg    photo; of many frames there is none
    depth_00000.png    16 bits, millimeters
    conf_00000.png     ARKit's levels 0 to 2

Layout: exports of the app (https://3dscannerapp.com), as public readers of them describe it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.phones import arkit
from fastsplat.service.capture.uploads.posed_input import PosedDataset, PosedImage

_FRAME = re.compile(r"frame_(\d{1,9})\.json")


def find_scanner_app(files: Iterable[str]) -> str:
    """Finds the folder of frames, relative to the upload; "" if this is no such recording."""
    paths = [PurePosixPath(path) for path in files]
    names = {path.as_posix() for path in paths}
    frames = (path for path in paths if _FRAME.fullmatch(path.name))
    folders = {path.parent for path in frames if path.with_suffix(".jpg").as_posix() in names}
    return min(folders, key=lambda folder: (len(folder.parts), folder)).as_posix() if folders else ""


def read_scanner_app(
    root: Path, folder: str, sizes: Mapping[str, tuple[int, int]], settings: CaptureSettings, left_out: LeftOut
) -> PosedDataset:
    """Reads cameras, poses and depth maps; arguments and errors as `read_polycam`."""
    place = PurePosixPath(folder)
    names = sorted(path.name for path in (root / folder).iterdir() if _FRAME.fullmatch(path.name))
    with_photo = [name for name in names if (place / name).with_suffix(".jpg").as_posix() in sizes]
    chosen, warnings = arkit.spread(with_photo, settings)
    images = []
    for name in chosen:
        with left_out.costs((place / name).with_suffix(".jpg").as_posix(), (place / name).as_posix()):
            images.append(_image(root, place, name, sizes, settings))
    return arkit.recording(images, folder, warnings, left_out)


def _image(
    root: Path, place: PurePosixPath, name: str, sizes: Mapping[str, tuple[int, int]], settings: CaptureSettings
) -> PosedImage:
    path = (place / name).as_posix()
    document = arkit.json_object(root, path, settings)
    photo = (place / name).with_suffix(".jpg").as_posix()
    k = arkit.numbers(document.get("intrinsics"), 9, f"{path}: intrinsics")
    matrix = arkit.numbers(document.get("cameraPoseARFrame"), 16, f"{path}: cameraPoseARFrame").reshape(4, 4)
    number = PurePosixPath(name).stem.removeprefix("frame_")
    maps = (place / f"{kind}_{number}.png" for kind in ("depth", "conf"))
    return PosedImage(
        name=PurePosixPath(photo).name,
        path=photo,
        camera_model=arkit.pinhole([float(k[0]), float(k[4]), float(k[2]), float(k[5])], sizes[photo], path),
        world_from_camera=arkit.world_from_camera(matrix, path),
        depth=arkit.depth_file(root, maps),
    )
