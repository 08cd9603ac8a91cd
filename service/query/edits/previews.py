"""Previews of removals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.edits.edited_rows import edited_rows
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.masks import pack_bits
from fastsplat_contract.messages.edit_previews import EditPreview
from fastsplat_contract.messages.scenes import Edit


def preview_of(index: SceneIndex, version: str, edits: Sequence[Edit]) -> EditPreview:
    """Computes the Gaussians that edits would remove, each applied after those before it.

    Errors as `edited_rows`, with the field inside `edits`; other actions raise InvalidInputError."""
    left = np.arange(len(index.scene.gaussians))
    gone = np.zeros(len(left), np.bool_)
    counts = []
    for number, edit in enumerate(edits):
        try:
            if edit.action != "remove":
                raise InvalidInputError(
                    f"{edit.action} has no preview", field="action", hint="Send edits whose action is remove."
                )
            rows = edited_rows(index, edit)
            gone[left[rows]] = True
            counts.append(len(rows))
            if len(rows) == len(left):
                counts += [0] * (len(edits) - number - 1)
                break
            if len(rows) and number + 1 < len(edits):
                index = index.after(apply_edit(index, edit))
                left = np.delete(left, rows)
        except (InvalidInputError, NotFoundError) as error:
            raise error.within(f"edits[{number}]") from error
    return EditPreview(version, len(gone), int(gone.sum()), tuple(counts), pack_bits(gone))
