"""Queries as they come (NumPy, torch, Warp) as one flat float32 ``wp.array`` on the bounder's device."""

import sys

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError

__all__ = ["flat_queries", "memory_of", "new_output"]

WHOLE = "iu"  # kinds of NumPy's types of whole numbers
ROUNDED = (
    "queries must be float32, float64 or whole numbers that float32 holds exactly, as all up to 16,777,216, got others"
)
MOST_NUMBERS = 2**31 - 2**16  # kernels count in 32 bits, in blocks


def flat_queries(x, columns: int, device: wp.Device, shift: np.ndarray | None = None) -> tuple[wp.array, int, bool]:
    """Check queries and view them as flat float32; what is on the device already is not copied.

    Args:
        x: ``(N, columns)`` NumPy array, nested sequence of numbers, torch tensor or ``wp.array``; or a ``wp.array`` of
            ``vec_columns`` ``(N,)``. float32, float64, or whole numbers that float32 holds exactly.
        columns: Numbers per query.
        device: Where the queries are to be.
        shift: ``(columns,)`` float64: what is taken off them, in float64 and on the host, before they are rounded.

    Returns:
        The flat array (length ``N * columns``, at least 1), ``N``, and whether float64 was rounded.

    Raises:
        QueryError: For another shape, dtype or device, or whole numbers that float32 would round.
    """
    torch = sys.modules.get("torch")
    if shift is not None:
        flat_queries(x, columns, device)  # whether they are queries at all
        host = x.numpy() if isinstance(x, wp.array) else x.detach().cpu() if hasattr(x, "detach") else x
        return flat_queries(np.asarray(host, dtype=np.float64).reshape(-1, columns) - shift, columns, device)
    if isinstance(x, wp.array):
        return _from_warp(x, columns, device)
    if torch is not None and isinstance(x, torch.Tensor):
        whole = x.dtype in (torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64)
        if x.dtype not in (torch.float32, torch.float64) and not whole:
            raise QueryError(f"queries must be float32, float64 or whole numbers, got a torch tensor of {x.dtype}")
        if x.layout != torch.strided or x.device.type not in ("cpu", "cuda"):
            got = f"one of {x.layout} on device {x.device}"
            raise QueryError(f"queries must be a dense tensor on the CPU or a GPU, got {got}")
        _check_shape(tuple(x.shape), columns)
        _check_device(wp.device_from_torch(x.device), device)
        double = x.dtype == torch.float64
        flat = x.detach().to(torch.float32).contiguous().reshape(-1)
        if whole and bool((flat.to(x.dtype) != x.reshape(-1)).any()):
            raise QueryError(ROUNDED)
        return _at_least_one(wp.from_torch(flat, dtype=wp.float32, requires_grad=False), device), x.shape[0], double
    try:
        values = np.asarray(x)
    except ValueError as error:
        raise QueryError(f"queries must be an array of shape (N, {columns}), got a ragged sequence") from error
    listed, kind = not isinstance(x, np.ndarray), values.dtype.kind
    if isinstance(x, np.ma.MaskedArray):
        raise QueryError("queries must be a plain array, got a masked one; fill it first")
    native = values.dtype.newbyteorder("=")  # big-endian files are read, too
    if native not in (np.float32, np.float64) and kind not in WHOLE:
        got = values.dtype if kind in "biufc" else type(x).__name__
        raise QueryError(f"queries must be float32, float64 or whole numbers, got {got}")
    if values.shape == (0,) and listed:
        values = values.reshape(0, columns)
    _check_shape(values.shape, columns)
    double = native == np.float64
    with np.errstate(over="ignore", invalid="ignore"):
        flat = np.require(values, np.float32, ["C", "A"]).reshape(-1)
        if kind in WHOLE and (flat.astype(values.dtype) != values.reshape(-1)).any():
            raise QueryError(ROUNDED)
    flat = wp.array(flat, dtype=wp.float32, device=device, copy=not device.is_cpu)
    return _at_least_one(flat, device), len(values), double


def memory_of(x) -> tuple[int, tuple[int, ...]] | None:
    """Where queries lie and of what shape they are; ``None`` of a sequence that is no array."""
    if isinstance(x, np.ndarray):
        return x.__array_interface__["data"][0], x.shape
    if isinstance(x, wp.array):
        return x.ptr, x.shape
    torch = sys.modules.get("torch")
    if torch is not None and isinstance(x, torch.Tensor):
        return x.data_ptr(), x.shape
    return None


def _from_warp(x: wp.array, columns: int, device: wp.Device) -> tuple[wp.array, int, bool]:
    _check_device(x.device, device)
    scalar = getattr(x.dtype, "_wp_scalar_type_", x.dtype)
    vector = getattr(x.dtype, "_shape_", ())  # () for scalars, (n,) for vectors
    if scalar not in (wp.float32, wp.float64) or len(vector) > 1:
        expected = f"float32 or float64 (a wp.array of vec{columns}, or of numbers)"
        raise QueryError(f"queries must be {expected}, got {x.dtype.__name__}")
    _check_shape((*x.shape, *vector), columns)
    if not x.is_contiguous:
        x = x.contiguous()
    count = x.shape[0]
    if count == 0:
        return _at_least_one(wp.empty(0, dtype=wp.float32, device=device), device), 0, False
    flat = wp.array(ptr=x.ptr, dtype=scalar, shape=(count * columns,), device=device, copy=False)
    if scalar == wp.float64:
        return _rounded(flat), count, True
    flat._source = x  # keeps the memory alive for as long as the view
    return flat, count, False


def _rounded(flat: wp.array) -> wp.array:
    """float64 as float32, to nearest; on a CPU without a kernel, which would have to be compiled first."""
    if flat.device.is_cpu:
        with np.errstate(over="ignore"):
            return wp.array(flat.numpy().astype(np.float32), dtype=wp.float32, device=flat.device, copy=False)
    rounded = wp.empty(len(flat), dtype=wp.float32, device=flat.device)
    wp.utils.array_cast(flat, rounded)
    return rounded


def _check_shape(shape: tuple[int, ...], columns: int) -> None:
    if len(shape) != 2 or shape[1] != columns:
        raise QueryError(f"queries must have shape (N, {columns}), got {shape}")
    if shape[0] * columns > MOST_NUMBERS:
        raise QueryError(f"queries must be at most {MOST_NUMBERS // columns} at a time, got {shape[0]}")


def _check_device(given: wp.Device, expected: wp.Device) -> None:
    if given != expected:
        raise QueryError(f"queries must be on the bounder's device {expected}, got {given}; see bounder.to(device)")


def _at_least_one(flat: wp.array, device: wp.Device) -> wp.array:
    """Kernels may not be given null pointers."""
    return flat if flat.size else wp.zeros(1, dtype=wp.float32, device=device)


def new_output(out: wp.array | None, count: int, dtype, device: wp.Device) -> wp.array:
    """``out`` checked, or a new array of ``count``."""
    if out is None:
        return wp.empty(count, dtype=dtype, device=device)
    if not isinstance(out, wp.array) or out.dtype != dtype or out.shape != (count,) or not out.is_contiguous:
        got = type(out).__name__
        if isinstance(out, wp.array):
            gaps = "" if out.is_contiguous else " with gaps"
            got = f"one of shape {out.shape} and dtype {out.dtype.__name__}{gaps}"
        raise QueryError(f"out must be a contiguous wp.array of shape ({count},) and dtype {dtype.__name__}, got {got}")
    _check_device(out.device, device)
    return out
