"""Checks of pulled models: their contract, and an exercise with a known answer."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector, open_open_set_detector
from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.lexicon.wordnet import open_lexicon
from fastsplat.service.perception.models.model_manifest import ModelEntry
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.readers.ppocr import open_reader
from fastsplat.service.perception.results import Image
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat.service.perception.tagging import open_tagger
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat_contract.errors import ModelUnavailableError

_CANVAS = 320


def check_model(entry: ModelEntry, models: Path) -> None:
    """Checks that a model opens and solves an easy exercise, else `ModelUnavailableError`.

    Detectors prompted by embeddings are only opened, as their text encoder may be missing yet.
    """
    name = f"{entry.adapter}:{entry.name}"
    if entry.role == "text_encoder":
        cup, mug, bridge = open_text_encoder(name, models).encode(
            ["cup", "mug", "bridge"]
            if entry.adapter == "label_table"
            else ["a cup of coffee", "a mug of coffee", "a railway bridge"]
        )
        solved = float(cup @ mug) > float(cup @ bridge) + 0.05
        exercise = 'a "cup" nearer to a "mug" than to a "bridge"'
    elif entry.role == "segmenter":
        segmenter = open_segmenter(PerceptionSettings(segmenter=name), models)
        image, disc, box = _drawn_disc()
        mask = segmenter.masks(segmenter.embed(image), box)[0]
        solved = float((mask & disc).sum() / max(1, (mask | disc).sum())) > 0.9
        exercise = "the mask of a drawn disc"
    elif entry.role == "closed_set_detector":
        closed_set = open_closed_set_detector(PerceptionSettings(closed_set_detector=name), models)
        solved = "stop sign" in closed_set.detect(_drawn_stop_sign(), 0.3).labels
        exercise = "a drawn stop sign"
    elif entry.role == "open_set_detector" and entry.adapter != "yolo_world":
        detector = open_open_set_detector(PerceptionSettings(open_set_detector=name), models)
        solved = len(detector.detect(_drawn_stop_sign(), ["stop sign"], 0.1)) > 0
        exercise = "a drawn stop sign"
    elif entry.role == "tagger":
        tagger = open_tagger(PerceptionSettings(tagger=name), models)
        solved = bool(tagger.tag(_drawn_stop_sign()).max() > 0)
        exercise = "any tag of a drawn stop sign"
    elif entry.role == "lexicon":
        lexicon = open_lexicon(name, models)
        fruit = {sense.id for sense in lexicon.senses("fruit")}
        solved = any(fruit & lexicon.wider(sense.id).keys() for sense in lexicon.senses("bananas"))
        lexicon.close()
        exercise = 'that a "banana" is a "fruit"'
    elif entry.role == "reader":
        reader = open_reader(PerceptionSettings(reader=name), models)
        solved = "STOP" in [line.text for line in reader.read(_drawn_stop_sign())]
        exercise = "the word on a drawn stop sign"
    elif entry.role == "image_text":
        model = open_image_text(PerceptionSettings(image_text=name), models)
        sign, soup = model.encode(["a stop sign", "a bowl of soup"])
        picture = _drawn_stop_sign()
        (looks,) = model.embed(picture, [np.ones(picture.shape[:2], np.bool_)])
        solved = float(looks @ sign) > float(looks @ soup) + 0.01
        exercise = "a drawn stop sign, which is no bowl of soup"
    else:
        return
    if not solved:
        raise ModelUnavailableError(
            f"model {entry.name} opens but does not work: it fails on {exercise}",
            field=entry.name,
            hint="Its files or its conversion are not what the manifest expects.",
        )


def _drawn_disc() -> tuple[Image, NDArray[np.bool_], NDArray[np.float32]]:
    image = np.full((_CANVAS, _CANVAS, 3), (40, 60, 90), np.uint8)
    disc = np.zeros((_CANVAS, _CANVAS), np.uint8)
    cv2.circle(disc, (140, 170), 70, 1, -1)
    image[disc > 0] = (230, 160, 40)
    return image, disc > 0, np.array([[70, 100, 211, 241]], np.float32)


def _drawn_stop_sign() -> Image:
    """Draws a red octagon with white rim and word, on a pole, outdoors."""
    image = np.full((_CANVAS, _CANVAS, 3), (150, 190, 230), np.uint8)
    image[240:] = (90, 130, 70)
    cv2.rectangle(image, (155, 150), (165, 300), (120, 120, 120), -1)
    angles = np.pi / 8 + np.arange(8) * np.pi / 4
    for radius, color in ((72, (245, 245, 245)), (66, (190, 20, 30))):
        corners = np.stack([160 + radius * np.cos(angles), 115 + radius * np.sin(angles)], 1)
        cv2.fillPoly(image, [corners.round().astype(np.int32)], color, cv2.LINE_AA)
    cv2.putText(image, "STOP", (108, 130), cv2.FONT_HERSHEY_DUPLEX, 1.35, (250, 250, 250), 4, cv2.LINE_AA)
    return image
