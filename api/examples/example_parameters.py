"""Examples of path and query parameters in the OpenAPI document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastsplat.service.application.base.paging import write_page_token

IDS = {
    "scene_id": "3f2b8c1d9e4a4b6f8d7c5e2a1b0f9d8e",
    "operation_id": "9a7d5c3b1f2e4d6c8b0a1f3e5d7c9b2a",
    "upload_id": "c4e2a0f8d6b44a2e9f1d3b5c7a9e8f60",
    "key_id": "5d0c9a7e3b1f",
    "version": "7b1e9c3d5f2a4e6b9d8c0f1a3b5d7e92",
    "observation_id": "e5b0c9f2e7d1a4b38",
    "name_id": "8a6b1d2c4e5f4a3b9c7d0e1f2a3b4c5d-1",
}
"""Placeholder ids, which no server has."""

PAGE_TOKEN = write_page_token(1767225600.0, IDS["scene_id"])

PARAMETERS: Mapping[str, Any] = {
    **IDS,
    "asker_view": "front.png",
    "cell": 0.0,
    "coarse": False,
    "coverage": 0.9,
    "depth_scale": 0.001,
    "encoding": "runs",
    "export_scene format": "spz",
    "format": "transforms",
    "height": 3024,
    "label": "mug",
    "mask2d_encoding": "rle",
    "mask3d_encoding": "runs",
    "list_best_views text": "",
    "max_matches": 5,
    "max_views": 5,
    "negatives": ["object", "things", "stuff", "texture"],
    "outputs": ["objects"],
    "page_size": 50,
    "page_token": PAGE_TOKEN,
    "parts": True,
    "photos": 49,
    "preset": "balanced",
    "query text": ["mug", "ball"],
    "query view": ["front.png"],
    "robot_radius": 0.2,
    "scene": IDS["scene_id"],
    "state": "RUNNING",
    "templates": ["a photo of a {}"],
    "text": "mug",
    "object_id": 1,
    "object_ids": [1],
    "timeout_s": 20.0,
    "view": "front.png",
    "view_array kind": "depth",
    "view_picture kind": "overlay",
    "width": 4032,
}
"""Values by parameter name, or by "operation name" where one operation needs another value."""
