"""Arrays: queries as they come, new outputs, compaction of masks on the device, and objects that can be copied."""

import sys
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.runtime.launch import BlockLaunch, ready
from warp_bounding.runtime.native import named

# Queries as they come (NumPy, torch, Warp) as one flat float32 ``wp.array`` on the bounder's device.

WHOLE = "iu"  # kinds of NumPy's types of whole numbers
ROUNDED = "queries must be float32, float64 or whole numbers that float32 holds, as all up to 16,777,216, got others"
MOST_NUMBERS = 2**31 - 2**21  # kernels count in 32 bits, in blocks or as many at a time as there are threads


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
        if device.is_cpu:  # without a kernel, which would have to be compiled first
            with np.errstate(over="ignore"):
                rounded = wp.array(flat.numpy().astype(np.float32), dtype=wp.float32, device=device, copy=False)
        else:
            rounded = wp.empty(len(flat), dtype=wp.float32, device=device)
            wp.utils.array_cast(flat, rounded)
        return rounded, count, True
    flat._source = x  # keeps the memory alive for as long as the view
    return flat, count, False


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
        array = isinstance(out, wp.array)
        got = f"one of shape {out.shape}, strides {out.strides}, {out.dtype.__name__}" if array else type(out).__name__
        raise QueryError(f"out must be a contiguous wp.array of shape ({count},) and dtype {dtype.__name__}, got {got}")
    _check_device(out.device, device)
    return out


# Compaction on the device: the ascending indices of a mask's set entries, and their number. Nothing is read back.
#
# There are three steps: count per block, scan the counts, write. A single block is only written. On a CPU both passes
# over the mask use several threads.

CPU_BLOCK, CUDA_BLOCK = 16384, 64  # mask entries that one thread of a kernel goes through


@named("wb_count_in_blocks").block_kernel("""
const int begin = block * size; const int end = begin + size < count ? begin + size : count;
const unsigned char* const bytes = (const unsigned char*)mask.data;  // of others' memory they may be neither 0 nor 1
int sum = 0;
for (int i = begin; i < end; ++i) sum += bytes[i] != 0;
counts.data[block] = sum;
""")
def _count(mask: wp.array(dtype=wp.bool), count: int, size: int, block: int, counts: wp.array(dtype=wp.int32)): ...


@named("wb_write_indices").block_kernel("""
const int begin = block * size; const int end = begin + size < count ? begin + size : count;
int at = block > 0 ? ends.data[block - 1] : 0;
const int last = ends.data[block];
const unsigned char* const bytes = (const unsigned char*)mask.data;
int i = begin;
for (; i + 8 <= end && at < last; i += 8) {
    unsigned long long word;
    memcpy(&word, bytes + i, 8);
    if (!word) continue;  // where little is set, most of eight entries in a row are none
    for (int l = i; l < i + 8 && at < last; ++l) { indices.data[at] = l; at += bytes[l] != 0; }
}
for (; i < end && at < last; ++i) { indices.data[at] = i; at += bytes[i] != 0; }
if (end == count) total.data[0] = at;
""")
def _write(
    mask: wp.array(dtype=wp.bool),
    count: int,
    size: int,
    block: int,
    ends: wp.array(dtype=wp.int32),
    indices: wp.array(dtype=wp.int32),
    total: wp.array(dtype=wp.int32),
): ...


class Compaction:
    """The compaction of one mask, its memory made once.

    Attributes:
        indices: ``(N,)`` int32; after ``launch`` its first ``n`` entries are the ascending indices of what is true.
        count: ``n`` as a 1-element int32 array.
    """

    def __init__(self, mask: wp.array):
        """Make the memory for a ``(N,)`` bool mask, which is read at every launch; ``QueryError`` for another one."""
        if not isinstance(mask, wp.array) or mask.dtype != wp.bool or mask.ndim != 1 or not mask.is_contiguous:
            got = f"{mask.dtype.__name__} of shape {mask.shape}" if isinstance(mask, wp.array) else type(mask).__name__
            raise QueryError(f"mask must be a contiguous wp.array of bool of shape (N,), got {got}")
        device, count = mask.device, mask.shape[0]
        self.indices = wp.empty(count, dtype=wp.int32, device=device)
        self.count = wp.zeros(1, dtype=wp.int32, device=device)
        self._steps: list[tuple[Callable[[], None], Callable[[], None]]] = []  # each also as a graph can hold it
        if count == 0:
            return
        size = CPU_BLOCK if device.is_cpu else CUDA_BLOCK
        blocks = -(-count // size)
        items = count if device.is_cpu else blocks  # one launch item a block on CUDA
        options = {"device": device, "first_index": 3, "block": size}
        ends = wp.full(blocks, count, dtype=wp.int32, device=device)
        if blocks > 1:  # a single block begins to write at 0
            counts = wp.empty(blocks, dtype=wp.int32, device=device)
            scanning = scanned = partial(wp.utils.array_scan, counts, ends, inclusive=True)
            if device.is_cpu:  # the same without Warp's checks, which take longer than the sum
                scanning = partial(np.cumsum, counts.numpy(), out=ends.numpy())
            counting = BlockLaunch(_count, items, [mask, count, size, 0], [counts], **options)
            self._steps += [(counting.launch, counting.launch_whole), (scanning, scanned)]
            ready(_count, device)
        outputs = [self.indices, self.count]
        writing = BlockLaunch(_write, items, [mask, count, size, 0, ends], outputs, **options)
        self._steps.append((writing.launch, writing.launch_whole))
        ready(_write, device)

    def launch(self) -> tuple[wp.array, wp.array]:
        """Fill ``indices`` and ``count``, and return them."""
        for step, _ in self._steps:
            step()
        return self.indices, self.count

    def launch_recorded(self) -> tuple[wp.array, wp.array]:
        """As ``launch``, by launches of Warp's only, for a graph that is being captured; on one core of a CPU."""
        for _, step in self._steps:
            step()
        return self.indices, self.count


def compact(mask: wp.array) -> tuple[wp.array, wp.array]:
    """Indices of what is true in a mask.

    Args:
        mask: ``(N,)`` bool.

    Returns:
        ``(N,)`` int32, ascending indices in its first ``n`` entries, and ``n`` as a 1-element int32 array.

    Raises:
        QueryError: For another type or shape.

    Example:
        >>> indices, count = wb.compact(bounder.query(points))
        >>> int(count.numpy()[0]) == int(bounder.query(points).numpy().sum())
        True
    """
    return Compaction(mask).launch()


# Pickling and copying of objects that cache what cannot be copied: compiled functions, and memory of a device.


class Picklable:
    """Pickles and copies without its caches (``functools.cached_property``), which are made anew when needed.

    A copy has arrays of its own, read-only, because a proof is about their numbers. ``copy.copy`` shares arrays and
    caches.
    """

    def __getstate__(self) -> dict[str, Any]:
        kinds = [vars(kind).items() for kind in type(self).__mro__]
        cached = {name for own in kinds for name, value in own if isinstance(value, cached_property)}
        return {name: value for name, value in vars(self).items() if name not in cached}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __copy__(self) -> Any:
        made = object.__new__(type(self))
        vars(made).update(vars(self))
        return made
