"""Losses on rendered images: L1 with D-SSIM, and weighted cross-entropy of affinely mapped codes."""

from fastsplat.service.splatting.losses.functional import image_loss, semantic_loss

__all__ = ["image_loss", "semantic_loss"]
