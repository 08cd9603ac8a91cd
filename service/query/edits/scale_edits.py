"""Scaling of a scene by known lengths."""

from __future__ import annotations

import numpy as np

from fastsplat.service.common.combined_ratios import NORMAL_95
from fastsplat.service.query.measures.locating import locate
from fastsplat.service.query.measures.measuring import apart, extents_of
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.frames import scaled
from fastsplat.service.scene.artefact.scaling import ScaledLength, capture_scaling, combined
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.places import KnownSize
from fastsplat_contract.messages.scenes import Edit

_MAX_LENGTHS = 100
_UNSURE_ENDS = 0.03
"""Relative deviation of an object's length by its ends: at best a few per cent, and a scale persists."""


def scale_scene(index: SceneIndex, edit: Edit) -> Scene:
    """Scales a scene to meters by all its known lengths, old and new; see `combined`.

    Raises:
        NotFoundError: nothing is seen at a pixel; no such view.
        InvalidInputError: no or too many known lengths, a label or objects, or two places that coincide.
    """
    if edit.label is not None or edit.object_ids:
        raise InvalidInputError("scale is of the whole scene", field="label", hint="Send known lengths alone.")
    earlier = index.scene.scaling or capture_scaling(index.scene.facts)
    lengths = [] if earlier is None else [*earlier.lengths]
    known_count = len(edit.known_lengths) + len(edit.known_sizes)
    if not known_count or len(lengths) + known_count > _MAX_LENGTHS:
        raise InvalidInputError(
            f"{known_count} known lengths and sizes",
            field="known_lengths",
            limit=f"1 to {_MAX_LENGTHS} of a scene",
            hint="Send the length between two places, or the size of an object.",
        )
    unit = 1.0 if earlier is None else earlier.meters_per_unit
    for number, known in enumerate(edit.known_lengths):
        ends = []
        for name in ("first", "second"):
            try:
                ends.append(locate(index, getattr(known, name)))
            except (InvalidInputError, NotFoundError) as error:
                raise error.within(f"known_lengths[{number}].{name}") from error
        value, deviation = apart(*ends)
        if value <= 3 * deviation or value < np.finfo(np.float32).tiny:
            raise InvalidInputError(
                "the two places cannot be told apart",
                field=f"known_lengths[{number}].second",
                hint="Pick places that are further from each other.",
            )
        lengths.append(ScaledLength(value / unit, deviation / unit, known.meters, known.plus_minus / NORMAL_95))
    lengths += [_known_size(index, known, number, unit) for number, known in enumerate(edit.known_sizes)]
    return scaled(index.objects.scene, combined(lengths))


def _known_size(index: SceneIndex, known: KnownSize, number: int, unit: float) -> ScaledLength:
    """Converts an object's measured side to a known length, with `_UNSURE_ENDS` added."""
    try:
        index.objects.check_all((known.object_id,))
        obj = extents_of(index, known.object_id)
    except (InvalidInputError, NotFoundError) as error:
        raise error.within(f"known_sizes[{number}]") from error
    if known.side == "height" and index.scene.up() is None:
        raise InvalidInputError(
            "the scene does not tell what is up",
            field=f"known_sizes[{number}].side",
            hint="Send the longest side, or a length between two places.",
        )
    side = 2 if known.side == "height" else int(np.argmax(obj.box.size))
    value = obj.box.size[side]
    deviation = float(np.hypot(obj.deviations[side], _UNSURE_ENDS * value))
    if value <= 3 * deviation or value < np.finfo(np.float32).tiny:
        raise InvalidInputError(
            f"the size of object {known.object_id} is too unsure to scale by",
            field=f"known_sizes[{number}].object_id",
            hint="Use a larger object, or a length between two places.",
        )
    return ScaledLength(value / unit, deviation / unit, known.meters, known.plus_minus / NORMAL_95)
