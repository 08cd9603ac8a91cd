"""A scene as one HTML file: viewer of `api/web/src/offline/`, Gaussians, and answers."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.words.query_text import MAX_TEXTS
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import NotFoundError

TEMPLATE = Path(__file__).resolve().parents[3] / "api" / "web" / "dist" / "offline.html"
"""The built viewer, in a checkout and in a wheel."""

MAX_NAMES = 1_000
"""Limit of labels with answers in a file, those with most Gaussians first."""

_MAX_CAMERAS = 200
_PLACE = "<!--scene-->"
_LEVEL = 6


def scene_page(index: SceneIndex, name: str, spz: bytes) -> bytes:
    """Self-contained UTF-8 HTML file that works offline.

    It answers the scene's labels and aliases as the scene does now; other texts are not answerable.

    Raises:
        NotFoundError: the viewer is not built in this installation.
    """
    before, after = _viewer()
    known, counts = index.ranked.names, index.label_counts
    present = sorted(known.table, key=lambda label_id: -counts[label_id] if known.is_borne(label_id) else 1)
    entries = known.dictionary.entries
    listed = [entries[label_id - 1] for label_id in present[:MAX_NAMES]]
    names = list(dict.fromkeys(text for entry in listed for text in (entry.label, *entry.aliases)))
    data: dict[str, Any] = {
        "name": name,
        "cameras": [to_plain(posed) for posed in index.scene.cameras[:_MAX_CAMERAS]],
        "gaussians": len(index.scene.gaussians),
        "labels": [entry.label for entry in listed],
        "names": [{"name": text, "key": label_key(text), "answer": number} for number, text in enumerate(names)],
        "answers": list(_answers(index, names)),
        "left_out": len(present) - len(listed),
        "splat": b64encode(spz).decode(),
    }
    # Escaped, so that no name can close the script element or open another.
    content = json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'{before}<script type="application/json" id="scene">{content}</script>{after}'.encode()


def _answers(index: SceneIndex, names: list[str]) -> Iterator[dict[str, Any]]:
    packed: dict[tuple[int, ...], str] = {}
    at_once = MAX_TEXTS
    for start in range(0, len(names), at_once):
        check_cancelled()
        for answer in index.ask(names[start : start + at_once]):
            if answer.relevant_ids not in packed:
                bits = np.packbits(index.mask3d(answer)).tobytes()
                packed[answer.relevant_ids] = b64encode(gzip.compress(bits, _LEVEL, mtime=0)).decode()
            yield {
                "outcome": answer.outcome,
                "sentence": answer.sentence,
                "objects": [to_plain(obj) for obj in index.objects_of(answer)],
                "rows": packed[answer.relevant_ids] if answer.relevant_ids else "",
            }


def _viewer() -> tuple[str, str]:
    """Template before and after the scene's data."""
    try:
        before, place, after = TEMPLATE.read_text(encoding="utf-8").partition(_PLACE)
    except FileNotFoundError:
        place = ""
    if not place:
        raise NotFoundError(
            "the viewer of single files is not built in this installation",
            field="format",
            hint="Install Node.js 18.19 or later with npm and run: make page. The other formats work without it.",
        )
    return before, after
