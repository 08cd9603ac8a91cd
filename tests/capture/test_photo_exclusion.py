"""Photos that their owner wants left out of a validated upload."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from tests.capture.upload_files import PINHOLE, frames_of, points_file


def test_frames_that_are_excluded_are_left_out_and_named(
    upload: Callable[[dict[str, bytes]], Path], photo: Callable[..., bytes], settings: CaptureSettings
) -> None:
    files = {f"images/{i}.jpg": photo(i) for i in range(3)}
    document = json.dumps({**PINHOLE, "frames": frames_of(files)}).encode()
    folder = upload({**files, "points3d.ply": points_file((0, 0, 1)), "transforms.json": document})
    validate_upload(folder, settings)

    whole = build_capture(folder, folder.parent / "whole", settings, silent)
    capture = build_capture(folder, folder.parent / "out", settings, silent, exclude=("images/1.jpg",))

    assert len(whole.views) == 3 and not whole.report.left_out
    assert [view.posed.name for view in capture.views] == [whole.views[0].posed.name, whole.views[2].posed.name]
    assert load_capture(folder.parent / "out").report.left_out == {"images/1.jpg": "left out on request"}
    assert capture.report.images == 2 and len(capture.report.photos) == 2
