"""Real spherical harmonics up to degree 3 in 3DGS sign convention (plain torch)."""

from __future__ import annotations

import torch
from torch import Tensor

from fastsplat.service.scene.artefact.scene import SH_C0

# Sloan, "Efficient spherical harmonic evaluation", JCGT 2013.
_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


def basis(directions: Tensor, degree: int) -> Tensor:
    """Evaluates Y_k at unit directions [G, 3] for k < (degree + 1)², [G, K]."""
    x, y, z = directions.unbind(dim=1)
    columns = [torch.full_like(x, SH_C0)]
    if degree >= 1:
        columns += [-_C1 * y, _C1 * z, -_C1 * x]
    if degree >= 2:
        columns += [
            _C2[0] * x * y,
            -_C2[0] * y * z,
            _C2[1] * (2 * z * z - x * x - y * y),
            -_C2[0] * x * z,
            _C2[2] * (x * x - y * y),
        ]
    if degree >= 3:
        columns += [
            -_C3[0] * y * (3 * x * x - y * y),
            _C3[1] * x * y * z,
            -_C3[2] * y * (4 * z * z - x * x - y * y),
            _C3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -_C3[2] * x * (4 * z * z - x * x - y * y),
            _C3[4] * z * (x * x - y * y),
            -_C3[0] * x * (x * x - 3 * y * y),
        ]
    return torch.stack(columns, dim=1)


def sh_to_rgb(means: Tensor, sh: Tensor, camera_position: Tensor, degree: int) -> Tensor:
    """Computes max(0, 0.5 + Σ_k Y_k(d) sh_k), d = normalize(means − camera_position) or 0."""
    directions = torch.nn.functional.normalize(means - camera_position, dim=1, eps=1e-20)
    count = (degree + 1) ** 2
    return (torch.einsum("gk,gkc->gc", basis(directions, degree), sh[:, :count]) + 0.5).clamp_min(0.0)
