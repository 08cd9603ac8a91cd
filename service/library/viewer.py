"""The viewer of single files in a notebook's cell."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Viewer:
    """A scene in 3D: orbit, move, zoom, and its own names answered. A notebook shows it in the cell.

    Attributes:
        page: the HTML file of `ExportRequest(..., "html")`, which loads nothing from anywhere; needs WebGL 2.
        height: of the cell, CSS pixels.
    """

    page: bytes
    height: int = 560

    def save(self, path: str | Path) -> None:
        """Write the HTML file, which opens from disk."""
        Path(path).write_bytes(self.page)

    def _repr_html_(self) -> str:
        # An origin of its own: nothing in the frame can reach the notebook around it. Its question is a form.
        page = html.escape(self.page.decode(), quote=True)
        return (
            f'<iframe srcdoc="{page}" sandbox="allow-scripts allow-forms" title="the scene in 3D" width="100%" '
            f'height="{self.height}" style="border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"Viewer({len(self.page)} bytes of HTML)"
