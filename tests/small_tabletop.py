"""The table-top benchmark as a small capture with poses, points and label maps."""

from __future__ import annotations

import json
from pathlib import Path

from PIL import Image

_SIZE = (120, 90)


def small_tabletop(test_data: Path, target: Path, views: int) -> Path:
    """Write so many of its views at 120 x 90 pixels, with its label maps as the user's own; returns `target`."""
    source = test_data / "tabletop"
    document = json.loads((source / "transforms.json").read_text())
    document["frames"] = document["frames"][:: len(document["frames"]) // views][:views]
    document.pop("split")
    for key in ("w", "fl_x", "cx", "h", "fl_y", "cy"):
        document[key] = document[key] * _SIZE[0] / 480
    document["w"], document["h"] = _SIZE
    for folder in ("images", "masks"):
        (target / folder).mkdir(parents=True)
    for frame in document["frames"]:
        frame.pop("depth_path")
        for key, how in (("file_path", Image.Resampling.BOX), ("mask_path", Image.Resampling.NEAREST)):
            Image.open(source / frame[key]).resize(_SIZE, how).save((target / frame[key]).with_suffix(".png"))
            frame[key] = str(Path(frame[key]).with_suffix(".png"))
    document["ply_file_path"] = "points3d.ply"
    (target / "points3d.ply").write_bytes((source / "points3d.ply").read_bytes())
    (target / "transforms.json").write_text(json.dumps(document))
    return target
