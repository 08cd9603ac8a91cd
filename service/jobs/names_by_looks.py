"""Names of objects by their looks, from an image-text model."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fastsplat.service.common.logistic import logistic
from fastsplat.service.instances.naming.naming import NAMED_FROM
from fastsplat.service.instances.naming.second_look import add_names
from fastsplat.service.query.language.meaning.common_objects import all_common_objects, common_objects
from fastsplat.service.query.phrases.object_looks import LooksModel, log_odds, logit, seen_by, softmax_weights
from fastsplat.service.scene.artefact.scene import Objects
from fastsplat.service.scene.artefact.suggestions import MOST_SUGGESTED


def named_by_looks(objects: Objects, model: LooksModel, names: Sequence[str]) -> Objects:
    """Names objects by their looks from `NAMED_FROM`, if the model was measured, else suggests, as `add_names`.

    Args:
        names: of the scene, which count beside the common objects.
    """
    seen = seen_by(model, objects.table)
    if not seen:
        return objects
    more = [name for name in names if not common_objects(name)[1]]
    words = [*(obj.names[0] for obj in all_common_objects()), *more]
    cosines = model.cosines(seen, more)
    weights = softmax_weights(cosines, cosines.max(axis=1), model.calibration.temperature)
    shares = weights / weights.sum(axis=1, keepdims=True)
    probability = logistic(log_odds(model.calibration.name, logit(shares)))
    best = np.argsort(-shares, axis=1, kind="stable")[:, :MOST_SUGGESTED]
    rows = zip(seen, best, probability, strict=True)
    found = {obj.id: {words[at]: float(row[at]) for at in order} for obj, order, row in rows}
    least = NAMED_FROM if model.calibration.measured else math.inf
    return add_names(objects, found, name_probability=least).objects
