"""Questions of the demonstration: objects that are there, ambiguous words, and an object that is not there."""

from __future__ import annotations

from collections.abc import Sequence

SAMPLE_QUESTIONS = ("banana", "coffee", "fruit", "something to read", "bicycle")
"""For the sample capture: an object by its name, three ambiguous questions, and an object that is not there."""

_WIDER = {
    "teddy bear": "plush toy",
    "bed": "mattress",
    "cup": "tea",
    "wine glass": "wine",
    "bottle": "water",
    "bowl": "soup",
    "banana": "fruit",
    "apple": "fruit",
    "orange": "fruit",
    "spoon": "fork",
    "knife": "fork",
    "book": "novel",
    "laptop": "computer",
    "keyboard": "typing",
    "mouse": "computer",
    "tv": "screen",
    "couch": "sofa",
    "chair": "seat",
    "dining table": "desk",
    "potted plant": "flower",
    "vase": "cup",
    "car": "vehicle",
    "truck": "vehicle",
    "bicycle": "bike",
    "person": "human",
    "cat": "pet",
    "dog": "pet",
}
_ABSENT = ("submarine", "volcano", "bicycle")


def questions_for(labels: Sequence[str]) -> tuple[str, ...]:
    """Makes questions of a scene's labels, most Gaussians first.

    The two leading labels, a wider or neighbouring word (ambiguous on purpose), and a thing that is not there.
    """
    wider = next((_WIDER[label] for label in labels if label in _WIDER and _WIDER[label] not in labels), "furniture")
    absent = next(word for word in _ABSENT if word not in labels)
    return (*labels[:2], wider, absent)
