"""Measure what the scores of an image-text model mean, and write it down for the query room.

    python -m benchmarks.calibration.calibrate_looks --models DIR --model clip:FOLDER [--views 12] [--dry-run]

Things of the six rooms of the validation split are cut from drawn photos, as a job cuts them, and compared with the
names of all things in all rooms. A text is
true of the things that it names. Of each room's things and each text, the cosine and its lead over the room's median
give the probability (logistic regression); less the odds of any pair, it is the logarithm of the likelihood ratio that
answers weigh with what names say.
  auroc, brier, brier_of_base_rate, ece: on the six rooms of the test split, which set nothing.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.calibration.separation import auroc, calibration_error, logistic_fit
from benchmarks.provenance import parser_of
from benchmarks.rooms.drawing import ROOMS, Studio, camera_of, room_of
from benchmarks.rooms.pictures import phone_faults, photo_of
from fastsplat.service.common.logistic import logistic
from fastsplat.service.perception.image_text import ClipImageText, open_image_text
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.query.language.calibration import calibration_key
from fastsplat.service.query.language.probability import Logistic
from fastsplat.service.query.phrases.thing_looks import FILE, LooksCalibration, scores_of
from fastsplat_contract.camera import PosedCamera

F64 = NDArray[np.float64]
_BEST = 5
"""Pictures of a thing, as a job has them."""
_LEAST_PX = 250


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--models", type=Path, required=True, help="model directory")
    parser.add_argument("--model", required=True, help="image-text model, as the settings name it")
    parser.add_argument("--views", type=int, default=12, help="photos of a room")
    parser.add_argument("--dry-run", action="store_true", help="print, write nothing")
    options = parser.parse_args()
    model = open_image_text(PerceptionSettings(image_text=options.model), options.models)
    rooms = {split: [looked_at(name, model, options.views) for name in ROOMS[split]] for split in ROOMS}
    names = sorted({name for rows in rooms.values() for labels, _ in rows for name in labels})
    texts = dict(zip(names, model.encode(names).astype(np.float64), strict=True))
    calibration = fitted(*(pairs_of(rooms[split], texts) for split in ("validation", "test")))
    print(calibration.model_dump_json(indent=1))
    if not options.dry_run:
        known = json.loads(FILE.read_text())
        key = calibration_key(model.name, model.sha256)
        FILE.write_text(json.dumps({**known, key: calibration.model_dump()}, indent=1, sort_keys=True) + "\n")


def looked_at(name: str, model: ClipImageText, views: int) -> tuple[Sequence[str], F64]:
    """The labels of the things of a room that photos show well, and float64 [K, E], what they look like."""
    room, seed = room_of(name)
    studio, camera, rng = Studio(room, seed), camera_of(), np.random.default_rng([seed, 1])
    looks: dict[int, list[tuple[int, NDArray[np.float32]]]] = {}
    for number, pose in enumerate(room.poses[:: max(1, len(room.poses) // views)][:views]):
        shown = studio.shown(PosedCamera(camera, pose, f"{number:03d}.jpg"))
        photo = photo_of(shown.light, phone_faults(rng), rng)
        for thing in np.unique(shown.things[shown.things > 0]).tolist():
            mask = shown.things == thing
            if mask.sum() >= _LEAST_PX:
                looks.setdefault(thing, []).append((int(mask.sum()), model.embed(photo, mask)))
    best = {thing: sorted(own, key=lambda each: -each[0])[:_BEST] for thing, own in sorted(looks.items())}
    means = np.array([np.mean([row for _, row in own], axis=0) for own in best.values()], np.float64)
    return [room.things[thing - 1].label for thing in best], means / np.linalg.norm(means, axis=1, keepdims=True)


def pairs_of(rooms: Sequence[tuple[Sequence[str], F64]], texts: dict[str, F64]) -> tuple[F64, NDArray[np.bool_]]:
    """Scores float64 [P, 2] of every thing of the rooms with every text, and bool [P], whether the text is its name.

    Args:
        rooms: labels and looks of each room's things.
        texts: float64 [E] each, by the text.
    """
    scores, truth = [], []
    for labels, looks in rooms:
        for text, embedding in texts.items():
            scores.append(scores_of(looks @ embedding))
            truth.append(np.array([label == text for label in labels]))
    return np.concatenate(scores), np.concatenate(truth)


def fitted(fitting: tuple[F64, NDArray[np.bool_]], judging: tuple[F64, NDArray[np.bool_]]) -> LooksCalibration:
    """The calibration that some pairs give, and its figures on others.

    Args:
        fitting, judging: see `pairs_of`.
    """
    scores, truth = fitting
    score, lead, offset = logistic_fit(scores, truth)
    base = float(truth.mean())
    ratio = Logistic(score=score, lead=lead, offset=round(offset - float(np.log(base / (1 - base))), 4))
    others, right = judging
    odds = float(np.log(right.mean() / (1 - right.mean())))
    likely = logistic(others @ np.array([ratio.score, ratio.lead]) + ratio.offset + odds)
    figures: dict[str, Any] = {
        "pairs": len(right),
        "true_pairs": int(right.sum()),
        "auroc": auroc(likely[right], likely[~right]),
        "brier": float(((likely - right) ** 2).mean()),
        "brier_of_base_rate": float(right.mean() * (1 - right.mean())),
        "ece": calibration_error(likely, right.astype(np.float64)),
    }
    rounded = {name: round(float(each), 4) for name, each in figures.items()}
    return LooksCalibration(ratio=ratio, date=datetime.date.today().isoformat(), figures=rounded)


if __name__ == "__main__":
    _main()
