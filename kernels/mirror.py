"""Copies of host arrays on a device, and arrays that host and device exchange repeatedly."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray


class Mirror:
    """Pair of a device array and a host array of equal shape. On a CPU, they share the memory.

    Parameters
    ----------
    shape
        Shape of the array.
    dtype
        A Warp scalar or vector type.
    device
        Warp device name.
    """

    def __init__(self, shape: int | tuple[int, ...], dtype: type, device: str) -> None:
        self.device = wp.zeros(shape, dtype=dtype, device=device)
        self._shared = device == "cpu"
        self.host: NDArray[Any] = (
            self.device.numpy() if self._shared else np.zeros_like(self.device.numpy())
        )

    def push(self) -> None:
        """Copy the host's values to the device."""
        if not self._shared:
            self.device.assign(self.host)

    def pull(self) -> None:
        """Copy the device's values to the host."""
        if not self._shared:
            self.host[...] = self.device.numpy()


def put(values: ArrayLike, dtype: type, device: str) -> Any:
    """Return a copy of an array on a device."""
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)


def placed(kernel: wp.Kernel, inputs: Sequence[object], device: str) -> list[Any]:
    """Copy NumPy arrays among the inputs of a kernel to a device, and return all inputs."""
    return [
        put(value, argument.type.dtype, device) if isinstance(value, np.ndarray) else value
        for value, argument in zip(inputs, kernel.adj.args, strict=False)
    ]


def filled(struct: Any, device: str, **members: Any) -> Any:
    """Return a filled instance of `struct`. NumPy arrays are copied to the device."""
    found = struct()
    for name, value in members.items():
        if isinstance(value, np.ndarray):
            value = put(value, struct.vars[name].type.dtype, device)
        setattr(found, name, value)
    return found
