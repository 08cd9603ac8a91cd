"""Text and codes on objects, read in photos and decided by votes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.capture.build import load_image
from fastsplat.service.capture.captures import View
from fastsplat.service.capture.formats.capture_files import load_content
from fastsplat.service.common.edit_distance import text_difference
from fastsplat.service.instances.naming.object_appearances import drawn_owners
from fastsplat.service.perception.readers.printed_codes import read_codes
from fastsplat.service.perception.results import LineReader, Writing
from fastsplat.service.scene.artefact.reads import bounded_reads, one_line
from fastsplat.service.scene.artefact.scene import Gaussians, Objects
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat_contract.messages.object_reads import ObjectRead, ReadKind

_MOST_DRAWN = 64  # number of views among which those to be read are chosen
_MOST_READ = 32
_BEST = 4  # number of views to read per object, those that show most of it
_INSIDE = 0.6  # share of a line's pixels that must belong to one object
_LEAST_LETTERS = 2
_MOST_SIGHTINGS = 400  # limit per object, the surest, as comparisons grow with its square
_SAME = 0.34  # lines of an object that differ by at most this share of letters are one line
_TRUST = 0.8  # factor for the reader's probability, which ignores what a slanted view hides
_LEAST_PROBABILITY = 0.5
_MANY = 4  # with this many reading views, a line read by a single one is dropped


@dataclass
class _Line:
    """A line of text on an object, with its readings by view."""

    key: str
    votes: dict[str, float]
    views: dict[int, tuple[str, float]]

    @property
    def weight(self) -> float:
        return sum(self.votes.values())


@torch.no_grad()
def with_reads(
    objects: Objects,
    gaussians: Gaussians,
    views: Sequence[View],
    reader: LineReader | None,
    max_side: int,
    on_view: Callable[[int, int], None] = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> Objects:
    """Adds to objects what is written on them.

    Text in pixels that a photo withholds (`load_content`) is ignored.

    Args:
        views: of the capture; at most 32 are read, those that show most of some object.
        reader: of lines; None: only codes are read.
        max_side: pixels of the rendered image's longer side.
        on_view: called for every view that was read.
    """
    owners = dict(drawn_owners(objects, gaussians, views, _MOST_DRAWN, max_side, backend))
    chosen = _views_to_read(owners, [obj.id for obj in objects.table])
    sightings: dict[int, list[tuple[int, Writing]]] = {}
    for done, number in enumerate(chosen, start=1):
        image, content = load_image(views[number]), load_content(views[number])
        for writing in [*([] if reader is None else reader.read(image)), *read_codes(image)]:
            obj = _object_of(writing, owners[number], content, (image.shape[1], image.shape[0]))
            if obj:
                sightings.setdefault(obj, []).append((number, writing))
        on_view(done, len(chosen))
    reads = {obj: voted_reads(readings) for obj, readings in sightings.items()}
    table = tuple(replace(obj, reads=reads[obj.id]) if reads.get(obj.id) else obj for obj in objects.table)
    return replace(objects, table=table)


def voted_reads(sightings: Sequence[tuple[int, Writing]]) -> tuple[ObjectRead, ...]:
    """Decides by votes what is written on an object.

    Similar lines are merged; the reading with the highest sum of probabilities counts. Parts of a line that is read
    whole elsewhere are dropped. Agreeing views raise the probability, others lower it; a single view is not believed
    where many read something.

    Args:
        sightings: view number and reading.
    """
    codes: dict[tuple[ReadKind, str], set[int]] = {}
    for view, writing in sightings:
        if writing.kind != "text":
            codes.setdefault((writing.kind, writing.text), set()).add(view)
    reads = [ObjectRead(kind, text, _probability([1.0] * len(hits)), len(hits)) for (kind, text), hits in codes.items()]
    seen = len({view for view, _ in sightings})
    for line in _lines([(view, writing) for view, writing in sightings if writing.kind == "text"]):
        text = max(line.votes, key=line.votes.__getitem__)
        key = _key(text)
        agreeing = [sure for said, sure in line.views.values() if _key(said) == key]
        against = sum(sure for said, sure in line.views.values() if _key(said) not in key)
        probability = _probability(agreeing) * sum(agreeing) / (sum(agreeing) + against)
        if probability >= _LEAST_PROBABILITY and (len(agreeing) > 1 or seen < _MANY):
            reads.append(ObjectRead("text", text, probability, len(agreeing)))
    return bounded_reads(reads)


def _lines(sightings: Sequence[tuple[int, Writing]]) -> list[_Line]:
    """Merges readings of an object that are similar, or contained in one another."""
    lines: list[_Line] = []
    for view, writing in sorted(sightings, key=lambda sighting: -sighting[1].probability)[:_MOST_SIGHTINGS]:
        text = one_line(writing.text)
        key = _key(text)
        if len(key) < _LEAST_LETTERS:
            continue
        line = next((candidate for candidate in lines if text_difference(key, candidate.key, _SAME) <= _SAME), None)
        if line is None:
            line = _Line(key, {}, {})
            lines.append(line)
        line.votes[text] = line.votes.get(text, 0.0) + writing.probability
        line.views.setdefault(view, (text, writing.probability))
    whole: list[_Line] = []
    for line in sorted(lines, key=lambda line: -len(line.key)):
        if not any(line.key in longer.key and 2 * longer.weight >= line.weight for longer in whole):
            whole.append(line)
    return whole


def _key(text: str) -> str:
    return "".join(char for char in text.casefold() if char.isalnum())


def _probability(sure: Sequence[float]) -> float:
    """Probability that not all readings are wrong, each of another view."""
    return float(1 - np.prod([1 - _TRUST * probability for probability in sure]))


def _views_to_read(owners: Mapping[int, NDArray[np.uint16]], ids: Sequence[int]) -> list[int]:
    """Returns the views that are best for an object, up to a limit."""
    numbers = list(owners)
    if len(numbers) <= _MOST_READ:
        return numbers
    classes = max(ids, default=0) + 1
    areas = np.stack([np.bincount(owners[number].ravel(), minlength=classes)[:classes] for number in numbers])
    wanted: Counter[int] = Counter()
    for obj in ids:
        best = np.argsort(-areas[:, obj], kind="stable")[:_BEST]
        wanted.update(numbers[at] for at in best.tolist() if areas[at, obj])
    return sorted(number for number, _ in wanted.most_common(_MOST_READ))


def _object_of(
    writing: Writing, owner: NDArray[np.uint16], content: NDArray[np.bool_] | None, size: tuple[int, int]
) -> int:
    """Returns the object of a reading; 0 for none, several, or withheld pixels."""
    height, width = owner.shape
    corners = writing.corners * np.array([width / size[0], height / size[1]], np.float32)
    inside = np.zeros(owner.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.floor(corners).astype(np.int32), 1)
    if content is not None:
        usable = cv2.resize(content.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        if (inside > usable).any():
            return 0
    counts = np.bincount(owner[inside > 0])
    if not len(counts):
        return 0
    obj = int(counts.argmax())
    return obj if counts[obj] >= _INSIDE * counts.sum() else 0
