"""Losses on rendered images: L1 with D-SSIM, and weighted cross-entropy of affinely mapped codes."""
