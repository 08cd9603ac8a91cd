"""Calibration of an image-text model on the machine that uses it: what its scores mean.

Drawn rooms are looked at as a scene's photos are. Figures are of rooms whose kind set nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from fastsplat.service.common.logistic import logistic
from fastsplat.service.common.progress import Progress, ProgressEvent, silent
from fastsplat.service.instances.naming.naming import NAMED_FROM
from fastsplat.service.instances.naming.object_appearances import best_sights, pooled_embedding, sights_by_view
from fastsplat.service.jobs.looks_rooms import LabeledRoom, drawn_rooms
from fastsplat.service.perception.image_text import F32, ClipImageText
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
    softmax_weights,
    text_share,
)

F64 = NDArray[np.float64]

_BATCH = 64
_TEMPERATURES = (1e-3, 1.0)
_TOP = 5  # likeliest names of an object that are judged
_RIDGE = 0.5  # of logistic models, towards the identity
_TINY = 1e-12
_LOOKING = 0.7  # share of the progress


@dataclass(frozen=True)
class _Objects:
    """Objects of all rooms, with their scores."""

    room: NDArray[np.int64]  # [K]
    kind: NDArray[np.str_]  # [K], of the room
    word: NDArray[np.int64]  # [K], the row of its label in `words`
    weight: F64  # [K], objects of one label in a room count together as the root of their number
    cosines: F64  # [K, V], with the common objects
    names_right: NDArray[np.bool_]  # [K, V]
    words: Sequence[str]  # W labels of all rooms
    of_words: F64  # [K, W], cosines with them
    words_right: NDArray[np.bool_]  # [K, W]

    def of(self, rows: NDArray[np.bool_]) -> _Objects:
        """Some of the objects."""
        arrays: dict[str, Any] = {
            name: array[rows] for name, array in vars(self).items() if isinstance(array, np.ndarray)
        }
        return replace(self, **arrays)

    def shares(self, temperature: float) -> tuple[F64, F64]:
        """Shares of common objects [K, V] as names have them, and of words [K, W] as questions have them."""
        peak = np.maximum(self.cosines.max(axis=1), self.of_words.max(axis=1))
        weights, of_words = (softmax_weights(rows, peak, temperature) for rows in (self.cosines, self.of_words))
        total = weights.sum(axis=1)
        pairs = zip(self.words, of_words.T, strict=True)
        shares = np.stack([text_share(word, weights, total, row) for word, row in pairs], axis=1)
        return weights / np.maximum(total, _TINY)[:, None], shares


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
    temperature, name, text, present = _fitted(measured)
    held_out = HeldOut.model_validate({**_matched(measured), **counts})
    facts = {"model": model.name, "sha256": model.sha256, "common_objects": common_objects_digest()}
    fit = {"temperature": temperature, "name": name, "text": text, "present": present}
    return Calibration.model_validate({**facts, **fit, "held_out": held_out}), common


def _measured(
    model: ClipImageText, rooms: Iterable[LabeledRoom], report_progress: Progress
) -> tuple[_Objects, NDArray[np.float16]]:
    numbers, kinds, labels, weights = [], [], list[str](), list[float]()
    embeddings: list[NDArray[np.float16]] = []
    for number, room in enumerate(rooms):
        fraction = _LOOKING * (1 - 1 / (1 + number / 8))
        report_progress(ProgressEvent("calibration", fraction, f"looking at drawn room {number + 1}"))
        sights = best_sights(enumerate(ids for _, ids in room.views), room.labels)
        found: dict[int, list[F32]] = {object_id: [] for object_id in sights}
        for view, visible in sights_by_view(sights).items():
            looks = model.embed(room.views[view][0], [sight.mask for _, sight in visible])
            for (object_id, _), look in zip(visible, looks, strict=True):
                found[object_id].append(look)
        embeddings += map(pooled_embedding, found.values())
        seen = [room.labels[object_id] for object_id in sights]
        weights += [seen.count(label) ** -0.5 for label in seen]
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
        np.array([words.index(label) for label in labels]),
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


def _fitted(measured: _Objects) -> tuple[float, Logistic, Logistic, Logistic]:
    """Temperature and models of names, texts and presence by maximum likelihood; presence has a prior of 1/2."""

    def loss(log_temperature: float) -> float:
        shares = np.take_along_axis(measured.shares(math.exp(log_temperature))[1], measured.word[:, None], axis=1)
        return float(-(measured.weight * np.log(np.maximum(shares[:, 0], _TINY))).sum())

    fit = minimize_scalar(loss, bounds=tuple(np.log(_TEMPERATURES)), method="bounded", options={"xatol": 0.02})
    temperature = math.exp(fit.x)
    of_names, of_words = measured.shares(temperature)
    best = np.argsort(-of_names, axis=1, kind="stable")[:, :_TOP]
    name, text = (
        _logistic(logit(shares), right, np.broadcast_to(measured.weight[:, None], shares.shape))
        for shares, right in (
            (np.take_along_axis(of_names, best, axis=1), np.take_along_axis(measured.names_right, best, axis=1)),
            (of_words, measured.words_right),
        )
    )
    most, there = _by_room(measured, of_words, text)
    balance = 0.5 / np.maximum(np.where(there, there.mean(), (~there).mean()), _TINY)
    return temperature, name, text, _logistic(most, there, balance)


def _by_room(measured: _Objects, of_words: F64, text: Logistic) -> tuple[F64, NDArray[np.bool_]]:
    """Logit [R, W] of a room's likeliest object for each word, and whether the word is true of any there."""
    logits = logit(logistic(log_odds(text, logit(of_words))))
    inside = [measured.room == number for number in np.unique(measured.room)]
    most = np.stack([logits[rows].max(axis=0) for rows in inside])
    return most, np.stack([measured.words_right[rows].any(axis=0) for rows in inside])


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
    temperature, name, text, present = _fitted(measured.of(measured.kind != kind))
    rooms = measured.of(measured.kind == kind)
    of_names, of_words = rooms.shares(temperature)
    right = np.take_along_axis(rooms.names_right, of_names.argmax(axis=1)[:, None], axis=1)[:, 0]
    sure = logistic(log_odds(name, logit(of_names.max(axis=1))))
    most, there = _by_room(rooms, of_words, text)
    refused = logistic(log_odds(present, most)) < RATHER
    given = sure >= NAMED_FROM
    return {
        "right": int(right.sum()),
        "given": int(given.sum()),
        "given_right": int((given & right).sum()),
        "expected": float(sure[given].sum()),
        "denied": int((refused & there).sum()),
        "present": int(there.sum()),
        "refused": int((refused & ~there).sum()),
        "absent": int((~there).sum()),
    }


def _matched(measured: _Objects) -> dict[str, int]:
    """Counts of a room's labels that are nearest to their objects among the room's labels."""
    matched, labels, rooms = 0, 0, np.unique(measured.room)
    for room in rooms:
        inside = measured.of(measured.room == room)
        here = np.unique(inside.word)
        labels += len(here)
        for word in here:
            scores = inside.of_words[inside.word == word][:, here].mean(axis=0)
            matched += int(here[scores.argmax()] == word)
    return {"rooms": len(rooms), "objects": len(measured.room), "matched": matched, "labels": labels}
