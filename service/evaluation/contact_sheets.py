"""Contact sheets of test views: photo, truth, prediction, errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.evaluation.segmentation import mask_counts
from fastsplat.service.evaluation.types import ViewPrediction
from fastsplat.service.query.drawing.pictures import label_colors, overlay

U8 = NDArray[np.uint8]

_GAP = 4
_WRONG, _MISSED, _TOO_MUCH, _RIGHT = (230, 40, 40), (250, 200, 30), (230, 40, 40), (60, 180, 90)


def label_sheet(view: ViewPrediction) -> U8:
    """uint8 [h, w, 3]: photo, rendered view, true labels, predicted labels, errors, and the labels' colors by name.

    In the errors a wrong label is red and a missing one yellow. The view has a pose and a label map.
    """
    truth = view.truth
    assert truth.rgb is not None and truth.labels is not None and view.rgb is not None
    counted = np.ones(truth.labels.shape, np.bool_) if truth.valid is None else truth.valid
    wrong = counted & (view.label_map != truth.labels)
    errors = (truth.rgb // 3).astype(np.uint8)
    errors[wrong] = _WRONG
    errors[wrong & (view.label_map == UNDETECTED)] = _MISSED
    colors = label_colors(len(view.dictionary))
    true_labels, predicted = (_mixed(truth.rgb, colors[ids], ids > 0) for ids in (truth.labels, view.label_map))
    panels = (
        ("photo", truth.rgb), ("rendered", view.rgb), ("truth", true_labels), ("prediction", predicted),
        ("errors", errors),
    )  # fmt: skip
    counts = mask_counts(view.label_map, truth.labels, len(view.dictionary), truth.valid)
    iou = counts.iou()
    legend = [
        (f"{view.dictionary.label_of(number)} {'' if np.isnan(iou[number]) else f'{iou[number]:.2f}'}", colors[number])
        for number in np.union1d(truth.labels, view.label_map).tolist()
        if number
    ]
    return _sheet(f"{truth.name}   mean IoU {counts.macro_iou():.3f}", panels, legend)


def query_sheet(view: ViewPrediction) -> U8:
    """uint8 [h, w, 3]: a row for each text: photo, true mask, mask of the answer, errors (missed yellow, too much red).

    The view has a pose and annotated texts.
    """
    rgb = view.truth.rgb
    assert rgb is not None
    rows = []
    for query in view.queries:
        mask, true_mask = query.answer_mask, query.truth.mask
        errors = (rgb // 3).astype(np.uint8)
        errors[true_mask & mask] = _RIGHT
        errors[true_mask & ~mask] = _MISSED
        errors[~true_mask & mask] = _TOO_MUCH
        panels = (
            ("photo", rgb), ("truth", overlay(rgb, true_mask)), ("answer", overlay(rgb, mask)), ("errors", errors),
        )  # fmt: skip
        rows.append(_sheet(f"{view.truth.name}   {query.truth.text}", panels, ()))
    return np.concatenate(rows) if rows else rgb


def _mixed(rgb: U8, tint: U8, where: NDArray[np.bool_]) -> U8:
    grey = rgb.mean(axis=2, keepdims=True)
    mixed = 0.35 * grey + 0.65 * tint
    return np.asarray(np.where(where[..., None], mixed, 0.5 * grey).round(), dtype=np.uint8)


def _sheet(title: str, panels: Sequence[tuple[str, U8]], legend: Sequence[tuple[str, U8]]) -> U8:
    height, width = panels[0][1].shape[:2]
    size = max(12, height // 24)
    font = ImageFont.load_default(size)
    bar = round(size * 1.6)
    whole = len(panels) * (width + _GAP) - _GAP
    rows = _legend_rows(legend, font, whole, size)
    sheet = Image.new("RGB", (whole, 2 * bar + height + bar * len(rows)), (24, 24, 24))
    draw = ImageDraw.Draw(sheet)
    draw.text((_GAP, bar / 2), title, font=font, anchor="lm", fill=(255, 255, 255))
    for number, (name, pixels) in enumerate(panels):
        left = number * (width + _GAP)
        draw.text((left + _GAP, bar * 1.5), name, font=font, anchor="lm", fill=(200, 200, 200))
        sheet.paste(Image.fromarray(pixels), (left, 2 * bar))
    for number, row in enumerate(rows):
        y = 2 * bar + height + bar * number
        for x, text, color in row:
            draw.rectangle((x, y + bar // 4, x + size, y + bar // 4 + size), fill=tuple(color.tolist()))
            draw.text((x + size + _GAP, y + bar / 2), text, font=font, anchor="lm", fill=(255, 255, 255))
    return np.asarray(sheet)


def _legend_rows(
    legend: Sequence[tuple[str, U8]], font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int, size: int
) -> list[list[tuple[float, str, U8]]]:
    rows: list[list[tuple[float, str, U8]]] = []
    x = float(width)
    for text, color in legend:
        needed = font.getlength(text) + 2 * size + 2 * _GAP
        if x + needed > width:
            rows.append([])
            x = _GAP
        rows[-1].append((x, text, color))
        x += needed
    return rows
