"""Compiled kernels and their run options: thread count and instruction set.

Read at first use from FASTSPLAT_RASTER_THREADS, 1 to 256 (default: the CPUs available to the process, at most 64), and
FASTSPLAT_RASTER_ISA, avx512, avx2 or baseline (default: the best supported). Results do not depend on them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError

if TYPE_CHECKING:
    from torch import Tensor

try:
    from fastsplat.service.splatting.raster import _cpu
except ImportError as error:  # a checkout without a build
    raise ModelUnavailableError(
        "the compiled rasterizer is missing", hint="Install the package: pip install -e . --no-build-isolation"
    ) from error

kernels = _cpu
"""Compiled module with rasterizer, losses and optimizer."""

kernels.set_cancellation_check(check_cancelled)

_THREADS, _ISA = "FASTSPLAT_RASTER_THREADS", "FASTSPLAT_RASTER_ISA"
_MAX_THREADS, _MAX_DEFAULT_THREADS = 256, 64


@dataclass(frozen=True)
class KernelOptions:
    """Run options of kernels.

    Raises:
        InvalidInputError: thread count outside 1..256, or unsupported instruction set.
    """

    threads: int  # 1..256, per call
    isa: str  # one of `instruction_sets()`

    def __post_init__(self) -> None:
        if not 1 <= self.threads <= _MAX_THREADS:
            raise InvalidInputError(f"{self.threads} threads", field=_THREADS, limit=f"1..{_MAX_THREADS} threads")
        if self.isa not in instruction_sets():
            raise InvalidInputError(
                f"kernels {self.isa!r} cannot run here",
                field=_ISA,
                hint=f"Choose one of {', '.join(instruction_sets())}, or leave it unset.",
            )


def instruction_sets() -> tuple[str, ...]:
    """Lists the instruction sets this machine supports, best first."""
    return tuple(kernels.available_isas())


def options_from(environment: Mapping[str, str]) -> KernelOptions:
    """Reads options from environment variables; raises as `KernelOptions`."""
    threads, isa = environment.get(_THREADS, ""), environment.get(_ISA, "")
    if threads and not threads.isdecimal():
        raise InvalidInputError(f"{_THREADS}={threads!r}", field=_THREADS, limit=f"1..{_MAX_THREADS} threads")
    default = min(_MAX_DEFAULT_THREADS, len(os.sched_getaffinity(0)))
    return KernelOptions(int(threads) if threads else default, isa or instruction_sets()[0])


def kernel_options() -> KernelOptions:
    """Returns the options of the innermost `running_with`, or the process's."""
    return _override.get() or _process_options()


def running() -> dict[str, Any]:
    """`kernel_options` as arguments of a kernel."""
    return vars(kernel_options())


def arrays(**tensors: Tensor | None) -> dict[str, Any]:
    """Tensors of the CPU as arguments of a kernel, which reads and writes their own memory; bool as bytes."""
    given = {name: None if tensor is None else tensor.detach().numpy() for name, tensor in tensors.items()}
    return {name: a.view(np.uint8) if a is not None and a.dtype == np.bool_ else a for name, a in given.items()}


@contextmanager
def running_with(*, threads: int | None = None, isa: str | None = None) -> Iterator[None]:
    """Overrides options for this thread, for measurements and tests."""
    outer = kernel_options()
    options = KernelOptions(outer.threads if threads is None else threads, outer.isa if isa is None else isa)
    token = _override.set(options)
    try:
        yield
    finally:
        _override.reset(token)


_override: ContextVar[KernelOptions | None] = ContextVar("kernel options", default=None)


@cache
def _process_options() -> KernelOptions:
    return options_from(os.environ)
