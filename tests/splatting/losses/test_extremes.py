"""Losses at the ends of their arguments: in every implementation a right number, or an error by name."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest
import torch
from torch import Tensor

from fastsplat.service.splatting.losses import functional
from fastsplat.service.splatting.losses.functional import image_loss, semantic_loss
from fastsplat.service.splatting.raster.kernels import instruction_sets, running_with
from fastsplat.service.splatting.training.depth_regularization import surface_loss
from fastsplat_contract.errors import InvalidInputError

_HERE, _IGNORED, _UNCOVERED = (5, 6), (3, 4), (7, 2)  # pixels, of which one does not count, and one shows nothing
_COLORS, _CODES = ("image", "target"), ("codes_image", "weight", "bias", "labels", "class_weights")
_BAD = (nan, inf, -inf)
# Loss, argument, where, what is put there ("times": what all is multiplied by; "cut": rows that are left), refused by.
_TABLE = (
    *(("semantic", name, (1,), bad, name) for name in ("weight", "bias", "class_weights") for bad in _BAD),
    *(("semantic", "codes_image", _HERE, bad, "codes_image") for bad in (*_BAD, 1e25)),
    *(("semantic", "codes_image", _IGNORED, bad, "") for bad in (*_BAD, 1e25)),
    *(("semantic", "labels", _HERE, bad, "labels") for bad in (4, -1)),
    *(("semantic", "bias", (), torch.tensor([size, -size, 0.0, size]), "") for size in (1e20, 1e38, 3e38)),
    *(("semantic", name, "times", 1e38, name) for name in ("weight", "class_weights", "codes_image")),
    *(("semantic", name, "times", 1e17, "") for name in ("weight", "class_weights", "codes_image weight")),
    ("semantic", "class_weights", (1,), -1.0, "class_weights"),
    ("semantic", "class_weights", "times", 0.0, ""),
    *(("semantic", names, "cut", rows, "codes_image") for names, rows in (("bias", 3), ("codes_image labels", 0))),
    *(("image", name, at, bad, name) for name in _COLORS for bad in _BAD for at in (_HERE, _IGNORED)),
    *(("image", name, "times", size, name * (size > 1e4)) for name in _COLORS for size in (1e20, 1e4)),
    ("image", "image target", "times", 1e12, "image"),
    ("image", "valid", (), False, ""),
    ("image", "image target valid", "cut", 0, "image"),
    *(("image", name, "cut", 5, field) for name, field in (("target", "image"), ("valid", "valid"))),
    *(("surface", "target", _IGNORED, bad, "") for bad in _BAD),
    *(("surface", name, _UNCOVERED, bad, "") for name in ("depth", "squared") for bad in _BAD),
    ("surface", "alpha depth squared target valid", "cut", 0, "alpha"),
)  # fmt: skip


def changed_case(loss: str, names: str, where: Any, value: Any) -> dict[str, Tensor]:
    """Arguments of 14 × 15 pixels."""
    image, target = torch.rand(2, 14, 15, 3, generator=torch.Generator().manual_seed(7))
    valid, alpha = torch.ones(14, 15, dtype=torch.bool), image[..., 0] * 0.5 + 0.2
    valid[_IGNORED], alpha[_UNCOVERED] = False, 0.0
    case = {"image": image, "target": target, "valid": valid}
    if loss == "surface":
        case = {"alpha": alpha, "depth": alpha * (2 + alpha), "squared": 60 * alpha, "target": target, "valid": valid}
    elif loss == "semantic":
        labels, weights = (alpha * 4 + 0.5).long().where(valid, 0), torch.tensor([0.0, 1.0, 0.5, 1.0])
        case = dict(zip(_CODES, (image * 4 - 2, target[0, :4], target[0, 4:8, 0], labels, weights), strict=True))
    for name in names.split():
        changed = case[name] * value if where == "times" else case[name].clone()
        if isinstance(where, tuple):
            changed[where] = value
        case[name] = changed[:value] if where == "cut" else changed
    return case


def outcome(loss: str, case: dict[str, Tensor], *, double: bool = False) -> list[Tensor]:
    """The loss and its gradients."""
    parts = [part.double() if double and part.is_floating_point() else part.clone() for part in case.values()]
    inputs = [part.requires_grad_() for part in parts[: 1 if loss == "image" else 3]]
    if loss == "image":
        value = image_loss(parts[0], parts[1], 0.2, parts[2])
    else:
        value = surface_loss(*parts, 0.3, 0.7) if loss == "surface" else semantic_loss(*parts)
    return [value.detach(), *torch.autograd.grad(value, inputs)]


@pytest.mark.parametrize("way", [*instruction_sets(), "one_pass", "float64"])
@pytest.mark.parametrize(("loss", "names", "where", "value", "field"), _TABLE)
def test_a_right_number_or_an_error_by_name(
    loss: str, names: str, where: Any, value: Any, field: str, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, double = changed_case(loss, names, where, value), way == "float64"
    if way == "one_pass":
        monkeypatch.setattr(functional, "_fused", lambda *_: False)
    with running_with(isa=way if way in instruction_sets() else "baseline"):
        if field and not (double and loss == "image" and where == "times"):  # float64 holds these squares
            with pytest.raises(InvalidInputError) as refused:
                outcome(loss, case, double=double)
            assert refused.value.field == field
            return
        ours = outcome(loss, case, double=double)
    free = where in (_IGNORED, _UNCOVERED)  # any number is as good there
    usual = changed_case(loss, names, where, 0.5) if free else case
    for mine, theirs in zip(ours, outcome(loss, usual, double=True), strict=True):
        assert bool(mine.isfinite().all())
        if mine.ndim == 0 or free:
            assert torch.allclose(mine.double(), theirs, rtol=1e-4, atol=1e-6)
