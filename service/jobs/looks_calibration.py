"""Calibration of an image-text model on the machine that uses it: what its scores mean.

Drawn rooms are looked at as a scene's photos are. Figures are of rooms whose kind set nothing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from fastsplat.service.common.logistic import logistic
from fastsplat.service.common.progress import Progress, ProgressEvent, silent
from fastsplat.service.instances.naming.naming import NAMED_FROM
from fastsplat.service.instances.naming.object_appearances import best_sights, pooled_embedding
from fastsplat.service.jobs.looks_rooms import LabeledRoom, drawn_rooms
from fastsplat.service.perception.image_text import ClipImageText
from fastsplat.service.query.language.meaning.common_objects import all_common_objects, common_objects_digest
from fastsplat.service.query.language.meaning.probability import Logistic
from fastsplat.service.query.objects.absence import RATHER
from fastsplat.service.query.phrases.object_looks import (
    Calibration,
    HeldOut,
    is_true_of,
    log_odds,
    logit,
    prompt,
    text_shares,
    word_shares,
)
from fastsplat.service.scene.artefact.scene import STATED_FROM

F64 = NDArray[np.float64]

_BATCH = 64
_TEMPERATURES = (1e-3, 1.0)
_TOP = 5  # likeliest names of an object that are judged
_RIDGE = 0.5  # of logistic models, towards the identity
_LOOKING = 0.7  # share of the progress


@dataclass(frozen=True)
class _Objects:
    """Objects of all rooms, with their scores."""

    room: NDArray[np.int64]  # [K]
    kind: NDArray[np.str_]  # [K], of the room
    label: Sequence[str]
    weight: F64  # [K], objects of one label in a room count together as the root of their number
    cosines: F64  # [K, V], with the common objects
    names_right: NDArray[np.bool_]  # [K, V]
    words: Sequence[str]  # W labels of all rooms
    of_words: F64  # [K, W], cosines with them
    words_right: NDArray[np.bool_]  # [K, W]

    def shares_of_words(self, temperature: float) -> F64:
        """float64 [K, W], as questions have them."""
        pairs = zip(self.words, self.of_words.T, strict=True)
        return np.stack([text_shares(word, self.cosines, row, temperature) for word, row in pairs], axis=1)


def calibrate_image_text(
    model: ClipImageText, report_progress: Progress = silent, rooms: Iterable[LabeledRoom] | None = None
) -> tuple[Calibration, NDArray[np.float16]]:
    """Measures what a model's scores mean, in about 2,000 pictures and 2,500 texts.

    Temperature, then the logistic models of names and of presence, are fitted by maximum likelihood on all rooms; the
    figures are predictions for each kind of rooms by a fit to the others.

    Args:
        report_progress: stage "calibration"; may raise `CancelledError`.
        rooms: of at least two kinds; None: those of the package.

    Returns:
        The calibration, refused or not (`measured`), and float16 [V, E], the embeddings of common objects.
    """
    measured, common = _measured(model, drawn_rooms() if rooms is None else rooms, report_progress)
    found = [_predicted(measured, kind) for kind in sorted(set(measured.kind.tolist()))]
    counts = {key: sum(counts[key] for counts in found) for key in found[0]}
    temperature, name, present = _fitted(measured, np.ones(len(measured.room), np.bool_))
    sizes = {"rooms": len(set(measured.room.tolist())), "objects": len(measured.room)}
    held_out = HeldOut.model_validate({**sizes, **_matched(measured), **counts})
    facts = {"model": model.name, "sha256": model.sha256, "common_objects": common_objects_digest()}
    fit = {"temperature": temperature, "name": name, "present": present}
    return Calibration.model_validate({**facts, **fit, "held_out": held_out}), common


def _measured(
    model: ClipImageText, rooms: Iterable[LabeledRoom], report_progress: Progress
) -> tuple[_Objects, NDArray[np.float16]]:
    numbers, kinds, labels, weights, embeddings = [], [], list[str](), list[float](), []
    for number, room in enumerate(rooms):
        fraction = _LOOKING * (1 - 1 / (1 + number / 8))
        report_progress(ProgressEvent("calibration", fraction, f"looking at drawn room {number + 1}"))
        sights = best_sights(enumerate(ids for _, ids in room.views), room.labels)
        seen = [room.labels[object_id] for object_id in sights]
        for label, found in zip(seen, sights.values(), strict=True):
            embeddings.append(pooled_embedding([model.embed(room.views[s.view][0], s.mask) for s in found]))
            weights.append(seen.count(label) ** -0.5)
        numbers += [number] * len(seen)
        kinds += [room.kind] * len(seen)
        labels += seen
    words = sorted(set(labels))
    texts = [*(prompt(obj.names[0]) for obj in all_common_objects()), *map(prompt, words)]
    parts = []
    for begin in range(0, len(texts), _BATCH):
        fraction = _LOOKING + (1 - _LOOKING) * begin / len(texts)
        report_progress(ProgressEvent("calibration", fraction, f"reading common objects {begin}/{len(texts)}"))
        parts.append(model.encode(texts[begin : begin + _BATCH]))
    text_rows = np.concatenate(parts)
    common = text_rows[: -len(words)].astype(np.float16)
    rows = np.stack(embeddings).astype(np.float64)
    names_right = {label: np.array([_is_right(obj.names, label) for obj in all_common_objects()]) for label in words}
    return _Objects(
        np.array(numbers),
        np.array(kinds),
        labels,
        np.array(weights),
        rows @ common.T.astype(np.float64),
        np.stack([names_right[label] for label in labels]),
        words,
        rows @ text_rows[-len(words) :].T.astype(np.float64),
        np.array([[is_true_of(word, label) for word in words] for label in labels]),
    ), common


def _is_right(names: Sequence[str], label: str) -> bool:
    """True if a common object's name may stand for an object that is `label`: the same, a kind of it, or above it."""
    return is_true_of(names[0], label) or is_true_of(label, names[0]) or label in names


def _fitted(measured: _Objects, rows: NDArray[np.bool_]) -> tuple[float, Logistic, Logistic]:
    """Temperature and logistic models of some of the objects."""
    truth = np.array([measured.words.index(label) for label in measured.label])
    weight = measured.weight[rows]

    def loss(log_temperature: float) -> float:
        shares = _true_shares(measured, truth, rows, float(np.exp(log_temperature)))
        return float(-(weight * np.log(np.maximum(shares, 1e-12))).sum())

    fit = minimize_scalar(loss, bounds=tuple(np.log(_TEMPERATURES)), method="bounded", options={"xatol": 0.02})
    temperature = float(np.exp(fit.x))
    of_words = logit(measured.shares_of_words(temperature)[rows])
    shares = word_shares(measured.cosines[rows], temperature)
    best = np.argsort(-shares, axis=1, kind="stable")[:, :_TOP]
    logits = np.concatenate([logit(np.take_along_axis(shares, best, axis=1)), of_words], axis=1)
    right = np.concatenate(
        [np.take_along_axis(measured.names_right[rows], best, axis=1), measured.words_right[rows]], axis=1
    )
    name = _logistic(logits.ravel(), right.ravel(), np.repeat(weight, logits.shape[1]))
    most, there = _by_room(measured, logit(logistic(log_odds(name, of_words))), rows)
    balance = np.where(there, 0.5 / max(there.mean(), 1e-9), 0.5 / max((~there).mean(), 1e-9))  # a prior of 1/2
    return temperature, name, _logistic(most.ravel(), there.ravel(), balance.ravel())


def _true_shares(measured: _Objects, truth: NDArray[np.int64], rows: NDArray[np.bool_], temperature: float) -> F64:
    shares = np.zeros(len(truth))
    for word in np.unique(truth[rows]).tolist():
        at = np.flatnonzero(rows & (truth == word))
        shares[at] = text_shares(
            measured.words[word], measured.cosines[at], measured.of_words[at, word], temperature
        )  # fmt: skip
    return shares[rows]


def _by_room(measured: _Objects, logits: F64, rows: NDArray[np.bool_]) -> tuple[F64, NDArray[np.bool_]]:
    """Largest logit [R, W] of each word among a room's objects, and whether it is true of any."""
    room, right = measured.room[rows], measured.words_right[rows]
    each_room = [room == number for number in np.unique(room)]
    return (
        np.stack([logits[inside].max(axis=0) for inside in each_room]),
        np.stack([right[inside].any(axis=0) for inside in each_room]),
    )


def _logistic(logits: F64, right: NDArray[np.bool_], weight: F64) -> Logistic:
    """Fits a model that never falls with the logit."""
    sign = np.where(right, 1.0, -1.0)

    def loss(factors: F64) -> float:
        predicted = factors[0] * logits + factors[1]
        ridge = (factors[0] - 1) ** 2 + factors[1] ** 2
        return float((weight * np.logaddexp(0.0, -sign * predicted)).sum() + _RIDGE / 2 * ridge)

    score, offset = minimize(loss, np.array([1.0, 0.0]), method="L-BFGS-B", bounds=[(0, None), (None, None)]).x
    return Logistic(score=round(float(score), 4), offset=round(float(offset), 4))


def _predicted(measured: _Objects, kind: str) -> dict[str, float]:
    """Counts of `HeldOut` for a kind of rooms, by a fit to the others."""
    rows = measured.kind == kind
    temperature, name, present = _fitted(measured, ~rows)
    shares = word_shares(measured.cosines[rows], temperature)
    best = shares.argmax(axis=1)
    right = measured.names_right[rows][np.arange(len(best)), best]
    sure = logistic(log_odds(name, logit(shares.max(axis=1))))
    of_words = logit(logistic(log_odds(name, logit(measured.shares_of_words(temperature)[rows]))))
    most, there = _by_room(measured, of_words, rows)
    refused = logistic(log_odds(present, most)) < RATHER
    given, stated = sure >= NAMED_FROM, sure >= STATED_FROM
    return {
        "right": int(right.sum()),
        "given": int(given.sum()),
        "given_right": int((given & right).sum()),
        "expected": float(sure[given].sum()),
        "stated": int(stated.sum()),
        "stated_right": int((stated & right).sum()),
        "denied": int((refused & there).sum()),
        "present": int(there.sum()),
        "refused": int((refused & ~there).sum()),
        "absent": int((~there).sum()),
    }


def _matched(measured: _Objects) -> dict[str, float]:
    """Counts of labels whose objects are nearest to their label among those of the room."""
    matched, labels, chance = 0, 0, 0.0
    for room in np.unique(measured.room):
        inside = np.flatnonzero(measured.room == room).tolist()
        here = sorted({measured.label[row] for row in inside})
        columns = [measured.words.index(label) for label in here]
        for number, label in enumerate(here):
            rows = [row for row in inside if measured.label[row] == label]
            matched += int(measured.of_words[rows][:, columns].mean(axis=0).argmax()) == number
        labels, chance = labels + len(here), chance + 1.0
    return {"matched": matched, "labels": labels, "chance": chance}
