"""Probabilities of labels from features of encoder and lexicon: pure arithmetic.

The model is a network with one hidden layer over the features of one label, fitted by benchmarks/calibration on
dictionaries of its own; its weights are in `meaning.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.language.meaning.label_meanings import BASE
from fastsplat.service.query.language.meaning.probability import Logistic, Nonconformities, leads
from fastsplat.service.query.language.meaning.relevancy import F64
from fastsplat.service.query.query_settings import QuerySettings

FILE = Path(__file__).with_name("meaning.json")
"""Written by benchmarks/calibration."""

_LEADS = {"similarity": 0.2, "definition": 0.2, "kinship": 0.0, "named": 0.2, "use": 0.2}
"""Columns whose lead over the best other label is a feature, with their background values."""
_LEAD_LIMIT = 0.4
_LIMIT = 5.0
"""Features are clipped to this many standard deviations."""


class MeaningModel(BaseModel):
    """The model of one encoder and one lexicon.

    Attributes:
        mean, scale: of the features, [F].
        hidden: weights of the hidden layer, [H, F]; `hidden_offset` [H]; `output` [H]; `offset`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    templates: tuple[str, ...]  # sentences that it was fitted with
    date: str  # ISO date
    lexicon: str  # the manifest's name of the lexicon
    base: tuple[str, ...]  # the columns that it weighs, as `BASE` was when it was fitted
    mean: tuple[float, ...]
    scale: tuple[float, ...]
    hidden: tuple[tuple[float, ...], ...]
    hidden_offset: tuple[float, ...]
    output: tuple[float, ...]
    offset: float
    entry: Logistic  # probability that who asks accepts a label, of its logit
    present: Logistic  # probability that anything in the dictionary answers, of the logarithm of the summed odds
    related: float  # the presence from which on labels are shown as answers
    scenes: Nonconformities  # nonconformities of the calibration dictionaries
    figures: Mapping[str, Any]  # of the cross-validation over dictionaries

    @cached_property
    def _arrays(self) -> tuple[F64, F64, F64, F64, F64]:
        return (
            np.array(self.mean),
            np.array(self.scale),
            np.array(self.hidden).T,
            np.array(self.hidden_offset),
            np.array(self.output),
        )

    def logits(self, base: F64) -> F64:
        """Logits [N] of the features of N labels [N, B]."""
        mean, scale, hidden, hidden_offset, output = self._arrays
        features = np.clip((expanded(base) - mean) / scale, -_LIMIT, _LIMIT)
        return np.asarray(np.tanh(features @ hidden + hidden_offset) @ output + self.offset)

    def likely(self, logits: F64) -> F64:
        """Probability of each label, [N], monotone in the logits."""
        return logistic(self.entry.score * logits + self.entry.offset)

    def presence(self, logits: F64, likely: F64) -> float:
        """Probability that any label answers; at least the likeliest one's, 0 without labels."""
        if not len(logits):
            return 0.0
        score = self.present.score * summed_odds(logits) + self.present.offset
        return float(max(logistic(np.array(score)), likely.max()))


def summed_odds(logits: F64) -> float:
    """log Σ exp(logits), of at least one logit."""
    return float(np.logaddexp.reduce(logits))


def expanded(base: F64) -> F64:
    """Adds leads over other labels and products to features [N, B], [N, F]."""
    column = dict(zip(BASE, base.T, strict=True))
    ahead = [leads(column[name], background, _LEAD_LIMIT) for name, background in _LEADS.items()]
    similarity, definition, known = column["similarity"], column["definition"], column["in_lexicon"]
    related = np.maximum.reduce([column["same"], column["wider"], column["narrower"]])
    products = [
        np.maximum(similarity, definition),
        np.minimum(similarity, definition),
        similarity * known,
        known * (1.0 - related),
        similarity * column["words"],
        column["last_word"] * known,
        definition * column["verb_phrase"],
        similarity * column["verb_phrase"],
        similarity * column["compound"],
        definition * column["compound"],
        column["kinship"] * known * (1.0 - related),
        column["shared_words"] * column["verb_phrase"],
        column["use"] * column["verb_phrase"],
        column["named"] * column["asked_known"],
    ]
    return np.vstack([base.T, *ahead, *products]).T


def weighs_meanings(settings: QuerySettings) -> bool:
    """True if the settings rank by similarity without thresholds, so that a model decides."""
    return settings.score == "similarity" and settings.threshold is None and settings.exact_threshold is None


def model_for(encoder_key: str, lexicon: str, templates: Sequence[str]) -> MeaningModel | None:
    """Model of an encoder, lexicon and templates; None if not measured together."""
    model = _load().get(encoder_key)
    if model is None or (model.lexicon, model.templates) != (lexicon, tuple(templates)):
        return None
    return model if model.base == BASE else None


@cache
def _load() -> dict[str, MeaningModel]:
    if not FILE.exists():
        return {}
    return {key: MeaningModel.model_validate(value) for key, value in json.loads(FILE.read_text()).items()}
