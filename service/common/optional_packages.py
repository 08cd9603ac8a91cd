"""Optional dependencies of some formats and commands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fastsplat_contract.errors import MissingPackageError


@dataclass(frozen=True)
class OptionalPackage:
    """A package that comes with an extra of the distribution.

    Attributes:
        name: as it is installed.
        modules: as they are imported.
        extra: the extra that brings it.
    """

    name: str
    modules: frozenset[str]
    extra: str


ASSISTANT = OptionalPackage("mcp", frozenset({"mcp", "mcp_types"}), "assistant")
LZFSE = OptionalPackage("lzfse", frozenset({"lzfse"}), "phones")
MCAP = OptionalPackage("foxglove-sdk", frozenset({"foxglove"}), "robots")


@contextmanager
def needed(
    package: OptionalPackage, what: str, field: str = "format", where: str = "where scenes are served"
) -> Iterator[None]:
    """Within it, an import that fails for want of the package raises `MissingPackageError`.

    Args:
        package: what is imported.
        what: needs it, as a sentence begins.
        field: of the request that asks for it.
        where: it is to be installed.
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
