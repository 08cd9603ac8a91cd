"""Times questions to a scene, in process; writes benchmarks/results/query.json.

    python -m benchmarks.query --models DIR [--lexicon NAME] [--rounds 31] [--large]

Scenes are asked as the product does, with the lexicon beside the encoder. Texts that are "new" were never embedded
before (names of common things, few of which are labels) and include the text encoder, and the rows "open" embed all
that is said of the labels; all others are cached. Every row is a median, the fastest round and the median CPU time of
all threads: on a busy machine they part.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import MADE_FAST_HERE, begin, parser_of, write_results
from benchmarks.query.labelled_garden import common_names, labelled_garden
from benchmarks.raster.garden import garden_file
from fastsplat.service.perception.lexicon.open_lexicon import open_lexicon
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.settings import QuerySettings
from fastsplat_contract.poses import pose_of
from fastsplat_contract.scenes import Edit

_TEXT = "something to drink from"
_TARGETS = {"rank_1000_labels": 1.0, "warm_query_new_text": 15.0, "label_map_640x480": 20.0}


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("--models", type=Path, required=True, help="model directory")
    parser.add_argument("--lexicon", default="wordnet", help="lexicon of the model manifest; empty: none")
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--large", action="store_true", help="a million Gaussians as well")
    arguments = parser.parse_args()
    start = begin()
    encoder = open_text_encoder("minilm_l6_int8", arguments.models, threads=2)
    opened = time.perf_counter()
    lexicon = open_lexicon(arguments.lexicon, arguments.models) if arguments.lexicon else None
    opened = time.perf_counter() - opened
    rows: list[dict[str, Any]] = []

    def row(name: str, run: Callable[[], object], rounds: int = arguments.rounds, **about: object) -> None:
        run()
        times, work = [], []
        for _ in range(rounds):
            start, busy = time.perf_counter(), time.process_time()
            run()
            times.append(1e3 * (time.perf_counter() - start))
            work.append(1e3 * (time.process_time() - busy))
        figures = {
            "name": name,
            **about,
            "median_ms": round(statistics.median(times), 3),
            "best_ms": round(min(times), 3),
            "cpu_ms": round(statistics.median(work), 3),
        }
        rows.append(figures | ({"target_ms": _TARGETS[name]} if name in _TARGETS else {}))
        print(json.dumps(rows[-1]), flush=True)

    new = iter(common_names())
    for labels in (20, 1_000):
        scene = labelled_garden(20_000, labels, encoder)
        row(f"open_{labels}_labels", lambda scene=scene: SceneIndex(scene, encoder, lexicon=lexicon), 1)
        index = SceneIndex(scene, encoder, lexicon=lexicon)
        for texts, name in (((_TEXT,), f"rank_{labels}_labels"), ((_TEXT,) * 64, f"rank_{labels}_labels_64_texts")):
            row(name, lambda index=index, texts=texts: index.ask(texts), 3 * arguments.rounds)
    for mode in ("codes", "evidence"):
        scene = labelled_garden(100_000, 20, encoder, mode)
        index, posed = SceneIndex(scene, encoder, lexicon=lexicon), scene.cameras[0]
        about = {"gaussians": 100_000, "labels": 20, "mode": mode}
        for name, run in _questions(index, new, posed):
            row(name, run, **about)
    _slow_rows(row, labelled_garden(40_000, 20, encoder), 5)
    if arguments.large:
        _slow_rows(row, labelled_garden(1_000_000, 20, encoder), 1)
    scene = "made, of garden's statistics" if garden_file() is None else "garden"
    report = {
        "scene": scene,
        "coverage": QuerySettings().coverage,
        "lexicon": arguments.lexicon or None,
        "lexicon_open_s": round(opened, 3),
        "rows": rows,
    }
    write_results("query", start, arguments, MADE_FAST_HERE, report)


def _questions(index: SceneIndex, new: Iterator[str], posed: Any) -> Iterator[tuple[str, Callable[[], object]]]:
    (answer,) = index.ask(["somewhere to sit"])

    def warm(text: str) -> None:
        (answered,) = index.ask([text])
        index.mask3d(answered)

    yield "warm_query_known_text", lambda: warm("somewhere to sit")
    yield "warm_query_new_text", lambda: warm(next(new))
    yield "mask3d", lambda: index.mask3d(answer)
    yield "mask2d_640x480", lambda: index.mask2d(answer, posed)
    yield "label_map_640x480", lambda: index.label_map(posed)


def _slow_rows(row: Callable[..., None], scene: Any, rounds: int) -> None:
    from fastsplat.service.query.things.gaussian_labels import label_gaussians

    size = len(scene.gaussians)
    index = SceneIndex(scene, _Fixed())
    label = scene.dictionary.entries[0].label
    row("label_field", lambda: label_gaussians(scene), rounds, gaussians=size)
    row("objects", lambda: SceneIndex(scene, _Fixed()).objects, rounds, gaussians=size)
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for edit in (
        Edit("remove", label=label),
        Edit("recolor", label=label, color=(1.0, 0.0, 0.0)),
        Edit("move", label=label, transform=pose_of(turn)),
        Edit("duplicate", label=label, transform=pose_of(turn)),
    ):
        row(f"edit_{edit.action}", lambda edit=edit: apply_edit(index, edit), rounds, gaussians=size)


class _Fixed:
    """An encoder for what asks nothing."""

    name, sha256 = "fixed", "0" * 64

    def encode(self, texts: Any) -> np.ndarray:
        return np.eye(1, 4, dtype=np.float32).repeat(len(texts), axis=0)


if __name__ == "__main__":
    main()
