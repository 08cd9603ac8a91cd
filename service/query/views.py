"""A scene seen from a pose: colours, depth, label maps and masks. One rasterization each."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from service.common.camera import PosedCamera
from service.query.settings import QuerySettings
from service.query.types import Mask2D
from service.scene.types import F32, Scene
from service.splatting.raster import Rendering, Splats, rasterize, sh_to_rgb

_CHUNK_LOGITS = 1 << 18


class Renderer:
    """The activated Gaussians of a scene, kept for the next view. Threads may share it."""

    def __init__(self, scene: Scene, settings: QuerySettings) -> None:
        gaussians = scene.gaussians
        self._settings = settings
        self._device = torch.device("cuda" if settings.backend == "cuda" else "cpu")
        self._means = self._tensor(gaussians.means)
        self._quats = self._tensor(gaussians.quats)
        self._scales = self._tensor(gaussians.log_scales).exp_()
        self._opacities = self._tensor(gaussians.logit_opacities).sigmoid_()
        self._sh = self._tensor(gaussians.sh)
        self._degree = gaussians.sh_degree
        self._codes = self._tensor(gaussians.codes)
        self._weight = self._tensor(scene.head.weight)
        self._bias = self._tensor(scene.head.bias)

    def colours(self, posed: PosedCamera) -> NDArray[np.uint8]:
        """uint8 [H, W, 3], on black."""
        return _to_bytes(self._rasterize(posed, self._rgb(posed)).image)

    def depth(self, posed: PosedCamera) -> F32:
        """float32 [H, W]: Σ w·z / Σ w in scene units, 0 where alpha is below `alpha_min`."""
        seen = self._rasterize(posed, self._means.new_zeros(len(self._means), 1))
        covered = seen.alpha >= max(self._settings.alpha_min, 1e-6)
        expected = torch.where(covered, seen.depth / seen.alpha.clamp_min(1e-6), 0.0)
        return _to_floats(expected)

    def label_map(self, posed: PosedCamera) -> NDArray[np.uint16]:
        """uint16 [H, W]: the most probable class, 0 where undetected or alpha is below `alpha_min`."""
        seen = self._rasterize(posed, self._codes if self._codes.shape[1] else self._nothing())
        classes, _ = self._classify(seen.image, None)
        covered = seen.alpha >= self._settings.alpha_min
        return np.asarray(torch.where(covered, classes, 0).cpu().numpy(), dtype=np.uint16)

    def mask(self, posed: PosedCamera, relevant: tuple[int, ...], relevancy: F32) -> Mask2D:
        """The pixels of the classes `relevant`, and Σ_n p(n)·relevancy(n)·alpha.

        p = softmax(W·code + b) of the composited code, not divided by alpha: that is what the training loss saw.

        Args:
            posed: the view.
            relevant: dictionary ids.
            relevancy: float32 [N + 1], by class; class 0 (undetected) should be 0.
        """
        seen = self._rasterize(posed, torch.cat([self._rgb(posed), self._codes], dim=1))
        classes, expected = self._classify(seen.image[..., 3:], self._tensor(relevancy))
        wanted = torch.zeros(len(self._bias), dtype=torch.bool, device=self._device)
        wanted[list(relevant)] = True
        mask = wanted[classes] & (seen.alpha >= self._settings.alpha_min)
        return Mask2D(
            mask=np.asarray(mask.cpu().numpy()),
            label_ids=np.asarray((classes * mask).cpu().numpy(), dtype=np.uint16),
            relevancy=_to_floats((expected * seen.alpha).clamp(0.0, 1.0)),
            rgb=_to_bytes(seen.image[..., :3]),
        )

    def _classify(self, codes: Tensor, relevancy: Tensor | None) -> tuple[Tensor, Tensor]:
        """int64 [H, W] argmax class and [H, W] Σ_n p(n)·relevancy(n) of composited codes [H, W, ≥ D], in pieces."""
        height, width = codes.shape[:2]
        flat = codes.reshape(height * width, -1)[:, : self._weight.shape[1]].to(self._weight.dtype)
        classes = torch.zeros(len(flat), dtype=torch.int64, device=self._device)
        expected = torch.zeros(len(flat), dtype=self._weight.dtype, device=self._device)
        columns = max(1, _CHUNK_LOGITS // len(self._bias))
        for start in range(0, len(flat), columns):
            piece = slice(start, start + columns)
            # Classes down, pixels across: reductions over the few classes then run along whole cache lines.
            logits = torch.addmm(self._bias[:, None], self._weight, flat[piece].T)
            best, classes[piece] = logits.max(dim=0)
            if relevancy is not None:
                weights = logits.sub_(best).exp_()
                expected[piece] = (relevancy @ weights) / weights.sum(dim=0)
        return classes.reshape(height, width), expected.reshape(height, width)

    def _rasterize(self, posed: PosedCamera, features: Tensor) -> Rendering:
        splats = Splats(self._means, self._quats, self._scales, self._opacities, features)
        viewmat = torch.tensor(posed.camera_from_world(), dtype=self._means.dtype, device=self._device)
        with torch.no_grad():
            return rasterize(splats, viewmat, posed.camera, backend=self._settings.backend)

    def _rgb(self, posed: PosedCamera) -> Tensor:
        position = torch.tensor(posed.world_from_camera[:3, 3], dtype=self._means.dtype, device=self._device)
        with torch.no_grad():
            return sh_to_rgb(self._means, self._sh, position, self._degree, backend=self._settings.backend)

    def _nothing(self) -> Tensor:
        return self._means.new_zeros(len(self._means), 1)

    def _tensor(self, array: F32) -> Tensor:
        return torch.tensor(np.asarray(array), dtype=torch.float32, device=self._device)


def _to_bytes(image: Tensor) -> NDArray[np.uint8]:
    return np.asarray((image.clamp(0.0, 1.0) * 255.0).round().to(torch.uint8).cpu().numpy())


def _to_floats(image: Tensor) -> F32:
    return np.asarray(image.to(torch.float32).cpu().numpy())
