"""Taggers (RAM, Zhang et al. 2023), whose tags prompt open-set detectors as in FAST-Splat."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.image_tensors import IMAGENET
from fastsplat.service.perception.models.model_files import checked_file, only_network
from fastsplat.service.perception.models.model_manifest import Adapter, find_model, select_adapter
from fastsplat.service.perception.onnx_session import check_contract, open_session
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Image
from fastsplat_contract.errors import ModelUnavailableError

F32 = NDArray[np.float32]

_TAG_FILES = ("tags.txt", "ram_tag_list.txt")
_THRESHOLD_FILES = ("thresholds.txt", "ram_tag_list_threshold.txt")


@dataclass(frozen=True)
class PooledTag:
    """A tag that several views agree on."""

    tag: str
    share: float  # of the views that show it, 0..1
    probability: float  # mean over the views that show it, 0..1


class RamTagger:
    """Adapter of RAM's contract, for any size and list of tags.

    `image` [1, 3, S, S] → [1, T] logits or probabilities of T tags. The image is resized to S × S without keeping its
    aspect, and ImageNet-normalized. The folder has `tags.txt`, a tag a line in the order of the output, and optionally
    `thresholds.txt`, as many numbers 0..1, or both under the names that RAM's authors gave them.

    Args:
        model: the ONNX file; S is 384 if its input leaves it open.
        threshold: of all tags, without a file of thresholds.

    Raises:
        ModelUnavailableError: a file is missing, damaged or breaks this contract.
    """

    def __init__(self, model: Path, folder: Path, *, name: str, threshold: float, threads: int = 0) -> None:
        self._name = name
        self.tags = tuple(_lines(_beside(folder, _TAG_FILES) or folder / _TAG_FILES[0], name))
        self._session = open_session(model, name=name, threads=threads)
        check_contract(self._session, name=name, inputs={"image": (1, 3, None, None)}, outputs=[(1, len(self.tags))])
        height, width = self._session.get_inputs()[0].shape[2:]
        side = height if isinstance(height, int) else IMAGENET.size
        if isinstance(width, int) and side != width:
            raise self._broken(f"its input is {width} × {side} pixels, no square", "Export it for square images.")
        self._preprocessing = IMAGENET.model_copy(update={"size": side})
        self.thresholds = self._thresholds(folder, threshold)
        # All probabilities lie within 0..1, but of thousands of logits none ever did: a black image tells.
        named = "logits" in self._session.get_outputs()[0].name
        self._logits = named or not _within(self._run(np.zeros((side, side, 3), np.uint8)))

    def tag(self, image: Image) -> F32:
        """Probability of each tag for an image, float32 [T]; may raise as the class."""
        output = self._run(image)
        if self._logits:
            return np.asarray(expit(output))
        if not _within(output):
            hint = "Export it with the sigmoid, and without the thresholds, or call the output `logits`."
            raise self._broken("its output is no probability of 0 to 1", hint)
        return output

    def _run(self, image: Image) -> F32:
        output = np.asarray(self._session.run(None, {"image": self._preprocessing.tensor(image)})[0], np.float32)
        if output.shape != (1, len(self.tags)):
            raise self._broken(
                f"it answers {list(output.shape)} for {len(self.tags)} tags",
                f"Put the list that the network was trained with beside it as {_TAG_FILES[0]}.",
            )
        return np.asarray(output[0])

    def _thresholds(self, folder: Path, usual: float) -> F32:
        path = _beside(folder, _THRESHOLD_FILES)
        if path is None:
            return np.full(len(self.tags), usual, np.float32)
        try:
            values = np.array([float(line) for line in _lines(path, self._name)], np.float32)
        except ValueError as error:
            raise self._broken(f"{path.name} holds something else than numbers", "One number a line.") from error
        if len(values) != len(self.tags) or not ((values >= 0) & (values <= 1)).all():
            raise self._broken(
                f"{path.name} does not hold {len(self.tags)} numbers of 0 to 1, one for each tag",
                f"Put both lists of one model beside it, or leave {path.name} out.",
            )
        return values

    def _broken(self, what: str, hint: str) -> ModelUnavailableError:
        return ModelUnavailableError(
            f"model {self._name} does not keep the contract of a tagger: {what}", field=self._name, hint=hint
        )


TAGGERS: Mapping[Adapter, type[RamTagger]] = {"ram": RamTagger}
"""Taggers by the manifest's adapter."""


def open_tagger(settings: PerceptionSettings, models: Path) -> RamTagger:
    """Opens the tagger of `settings.tagger`; raises `ModelUnavailableError` if that fails."""
    name = settings.tagger
    adapter, inside = find_model(name, "tagger")
    tagger = select_adapter(TAGGERS, adapter, name, "tagger")
    folder = models / inside
    return tagger(
        only_network(folder, name=name),
        folder,
        name=name,
        threshold=settings.tagger_threshold,
        threads=settings.threads,
    )


def pool_tags(
    tags: Sequence[str], probabilities: F32, thresholds: F32, *, min_share: float, min_views: int, limit: int
) -> list[PooledTag]:
    """Selects tags that enough views show, sorted by number of views, then by probability.

    Of spellings of one name (`label_key`) the first counts.

    Args:
        tags: T of them.
        probabilities: float32 [V, T].
        thresholds: float32 [T], from which a view shows a tag.
        min_share: of the views, that must show a tag.
        min_views: as `min_share`, in views; at most V.
    """
    views = len(probabilities)
    if not views:
        return []
    hits = probabilities >= thresholds
    enough = max(min(min_views, views), math.ceil(min_share * views), 1)
    counts = hits.sum(axis=0)
    means = np.where(hits, probabilities, 0).sum(axis=0) / np.maximum(counts, 1)
    order = np.lexsort((np.arange(len(tags)), -means, -counts))
    pooled: dict[str, PooledTag] = {}
    for number in order[counts[order] >= enough].tolist():
        tag = PooledTag(tags[number], float(counts[number] / views), float(means[number]))
        if label_key(tag.tag):
            pooled.setdefault(label_key(tag.tag), tag)
    return list(pooled.values())[:limit]


def propose_texts(
    load: Callable[[int], Image],
    positions: Sequence[int],
    settings: PerceptionSettings,
    models: Path,
    on_view: Callable[[int, str], None],
) -> list[str]:
    """Proposes texts for a detector by tagging views, see `pool_tags`."""
    tagger = open_tagger(settings, models)
    rows = []
    for done, position in enumerate(positions, start=1):
        rows.append(tagger.tag(load(position)))
        on_view(done, f"tagging, view {done}/{len(positions)}")
    pooled = pool_tags(
        tagger.tags,
        np.stack(rows) if rows else np.zeros((0, len(tagger.tags)), np.float32),
        tagger.thresholds,
        min_share=settings.min_view_share,
        min_views=settings.min_views,
        limit=settings.tagger_texts,
    )
    return [tag.tag for tag in pooled]


def _beside(folder: Path, names: Sequence[str]) -> Path | None:
    """The first of these files that a folder has."""
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _within(output: F32) -> bool:
    return bool(((output >= 0) & (output <= 1)).all())


def _lines(path: Path, name: str) -> list[str]:
    """Non-empty lines of a text file, stripped."""
    try:
        text = checked_file(path, name=name).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelUnavailableError(
            f"model {name}: {path} cannot be read",
            field=name,
            hint=f"A tagger needs its list of tags beside it, as {' or '.join(_TAG_FILES)}: one a line.",
        ) from error
    lines = [line.strip() for line in text.splitlines()]
    if not any(lines):
        raise ModelUnavailableError(f"model {name}: {path} is empty", field=name, hint="One entry a line.")
    return [line for line in lines if line]
