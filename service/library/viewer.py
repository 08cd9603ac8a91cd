"""3D viewer for notebook cells."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Viewer:
    """An interactive 3D scene that notebooks display: orbit, move, zoom, find its names."""

    page: bytes  # self-contained HTML of `ExportRequest(..., "html")`; needs WebGL 2
    height: int = 560  # of the cell, CSS pixels

    def save(self, path: str | Path) -> None:
        """Writes the HTML file, which opens from disk."""
        Path(path).write_bytes(self.page)

    def _repr_html_(self) -> str:
        # The sandbox gives it its own origin, so it cannot reach the notebook; the search box needs forms.
        page = html.escape(self.page.decode(), quote=True)
        return (
            f'<iframe srcdoc="{page}" sandbox="allow-scripts allow-forms" title="the scene in 3D" width="100%" '
            f'height="{self.height}" style="border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"Viewer({len(self.page)} bytes of HTML)"
