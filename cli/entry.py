"""Where the `fastsplat` command begins: loads it as fast as Python can, then runs it."""

from __future__ import annotations

from fastsplat.service.common.process import loading_modules


def main() -> None:
    """As `fastsplat.cli.main.main`."""
    with loading_modules():
        from fastsplat.cli.main import main as run
    run()
