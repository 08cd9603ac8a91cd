"""Machine-readable codes in pictures: QR codes, bar codes (EAN, UPC), AprilTags (one family)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from fastsplat.service.capture.world.scale_tags import TAG_COUNT, find_tags
from fastsplat.service.perception.results import Image, Writing
from fastsplat_contract.messages.object_reads import ReadKind


def read_codes(image: Image) -> list[Writing]:
    """Reads self-checking codes (probability 1) of a picture; tags that occur twice are left out."""
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
    tags = find_tags(gray, 0, range(TAG_COUNT))
    found, texts, corners, _ = cv2.QRCodeDetectorAruco().detectAndDecodeMulti(gray)
    codes = _decoded("qr", texts, corners) if found else []
    found, texts, corners, _ = cv2.barcode.BarcodeDetector().detectAndDecodeMulti(gray)
    codes += _decoded("barcode", texts, corners) if found else []
    return codes + [Writing("tag", str(tag.tag), 1.0, tag.corners.astype(np.float32)) for tag in tags]


def _decoded(kind: ReadKind, texts: Sequence[str], corners: Any) -> list[Writing]:
    """Keeps the codes that were not only found but decoded."""
    rows = np.asarray(corners, np.float32).reshape(-1, 4, 2)
    return [Writing(kind, text, 1.0, row) for text, row in zip(texts, rows, strict=True) if text]
