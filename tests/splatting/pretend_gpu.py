"""A device in memory whose tensors refuse `.numpy()` and host tensors, but for numbers, indices and copies, as CUDA."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = "meta"  # the only device but the CPU whose gradients run without an accelerator; it gets memory here
_HOST = torch.device("cpu")
_MIXING = {"aten.index.Tensor", "aten.index_put_.default", "aten.index_put.default", "aten.copy_.default"}
"""Which may have host tensors beside those of the device: as indices, or as what is copied from."""


class OnDevice(Tensor):
    """A tensor of the device, around a host tensor that nobody else sees."""

    inner: Tensor

    @staticmethod
    def __new__(cls, inner: Tensor) -> OnDevice:
        """Around `inner`."""
        tensor: OnDevice = torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls,
            inner.shape,
            strides=inner.stride(),
            storage_offset=inner.storage_offset(),
            dtype=inner.dtype,
            device=DEVICE,
            requires_grad=False,
        )
        tensor.inner = inner
        return tensor

    __torch_function__ = torch._C._disabled_torch_function_impl  # type: ignore[assignment]

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run on what is inside, refusing what a GPU would refuse."""
        return _run(function, args, kwargs or {})


class _Placing(TorchDispatchMode):
    """New tensors for the device, which have no argument on it, are made on it."""

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(function, args, kwargs or {})


class _Values(TorchFunctionMode):
    """`torch.tensor` for the device would drop its values, as the device has no memory elsewhere."""

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if function in (torch.tensor, torch.as_tensor) and _is_device(kwargs.get("device")):
            return function(*args, **{**kwargs, "device": _HOST}).to(DEVICE)
        if function is Tensor.tolist and isinstance(args[0], OnDevice):
            return args[0].inner.tolist()
        return function(*args, **kwargs)


@contextmanager
def pretended() -> Iterator[None]:
    """`DEVICE` is a device with memory while the block runs."""
    with _Values(), _Placing():
        yield


def _is_device(device: Any) -> bool:
    return device is not None and torch.device(device).type == DEVICE


def _run(function: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    leaves = tree_leaves((args, kwargs))
    there = any(isinstance(leaf, OnDevice) for leaf in leaves)
    if there and str(function) not in _MIXING:
        mixed = [leaf for leaf in leaves if isinstance(leaf, Tensor) and not isinstance(leaf, OnDevice) and leaf.dim()]
        if mixed:
            raise RuntimeError(f"{function}: expected all tensors to be on the same device, found the device and cpu")
    if str(function) == "aten._local_scalar_dense.default":
        return function(args[0].inner if there else args[0])
    target = kwargs.get("device")
    host = {**kwargs, "device": _HOST} if target is not None else kwargs
    result = function(*tree_map(_inside, args), **tree_map(_inside, host))
    if (there and target is None) or _is_device(target):
        result = tree_map(lambda leaf: OnDevice(leaf) if type(leaf) is Tensor else leaf, result)
        return return_and_correct_aliasing(function, args, kwargs, result) if there else result
    return result


def _inside(leaf: Any) -> Any:
    return leaf.inner if isinstance(leaf, OnDevice) else leaf
