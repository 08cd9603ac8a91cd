"""Optional dependencies of formats and commands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fastsplat_contract.errors import MissingPackageError


@dataclass(frozen=True)
class OptionalPackage:
    """A package installed by an extra of the distribution."""

    name: str  # distribution name
    modules: frozenset[str]  # import names
    extra: str


ASSISTANT = OptionalPackage("mcp", frozenset({"mcp", "mcp_types"}), "assistant")
LZFSE = OptionalPackage("lzfse", frozenset({"lzfse"}), "phones")
MCAP = OptionalPackage("foxglove-sdk", frozenset({"foxglove"}), "robots")
RAY = OptionalPackage("ray", frozenset({"ray"}), "cluster")


@contextmanager
def needed(
    package: OptionalPackage, what: str, field: str = "format", where: str = "where scenes are served"
) -> Iterator[None]:
    """Turns a failed import of the package into `MissingPackageError`.

    Args:
        package: imported within.
        what: subject of the error message.
        field: request field that requires it.
        where: place to install it, for the hint.
    """
    try:
        yield
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in package.modules:
            raise
        raise MissingPackageError(
            f"{what} needs the package {package.name}, which is not installed",
            field=field,
            hint=f"Install it {where}: pip install 'fastsplat[{package.extra}]'.",
        ) from error
