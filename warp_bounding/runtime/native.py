"""Warp's decorators for functions and kernels that a factory makes around native source, one for each size."""

import hashlib
import linecache
import platform
from functools import cache
from typing import Any

import warp as wp

__all__ = ["STRICT", "identity", "named", "unique_name"]


def _options() -> dict[str, str]:
    """Let the compiler use 512-bit registers where there are any; on some processors it prefers 256 bits."""
    flags = getattr(wp.config, "cpu_compiler_flags", None)
    if flags is None or platform.machine() not in ("x86_64", "AMD64"):
        return {}
    return {"cpu_compiler_flags": f"{flags} -mprefer-vector-width=512"}


STRICT = """
#if !defined(__CUDA_ARCH__)
#if defined(__FAST_MATH__) || __FINITE_MATH_ONLY__
#error "warp_bounding: proofs are about IEEE arithmetic, which -ffast-math (cpu_compiler_flags) gives up; leave it out"
#endif
#pragma clang fp reassociate(off) reciprocal(off)
#endif
"""


class named:  # noqa: N801 (used like a function: `@named(name).kernel`)
    """Warp's decorators for functions made in a factory; Warp would take equal names for overloads of one function.

    Warp reads the return type of a native function only under a decorator that is spelled ``x.func_native(...)``.
    """

    def __init__(self, name: str):
        self.name = name

    def func_native(self, snippet: str):
        """``wp.func_native`` under this name; the compiler may neither reorder nor approximate (``STRICT``)."""
        return lambda function: wp.func_native(STRICT + snippet)(self._rename(function, f"{self.name}_native"))

    def func(self, function):
        """``wp.func`` under this name."""
        return wp.func(self._rename(function, self.name))

    def kernel(self, function):
        """``wp.kernel`` under this name, in a module of its own."""
        named_function = self._rename(function, self.name)
        return wp.kernel(named_function, enable_backward=False, module="unique", module_options=_options())

    def block_kernel(self, snippet: str):
        """A kernel of which each thread runs ``snippet`` on one block; a stub that is decorated names the arguments.

        One of them is the int ``block``: to the snippet the number of its own block, to the kernel, whose other
        arguments are the same, that of the launch's first.
        """

        def kernel_of(stub):
            arguments = stub.__annotations__
            passed = ", ".join("block + wp.tid()" if name == "block" else name for name in arguments)
            text, file = f"def kernel({', '.join(arguments)}):\n    native({passed})\n", f"<{self.name}>"
            linecache.cache[file] = len(text), None, text.splitlines(True), file  # Warp reads the text of a kernel
            scope = {"native": self.func_native(snippet)(stub), "wp": wp}
            exec(compile(text, file, "exec"), scope)
            scope["kernel"].__annotations__ = arguments
            return self.kernel(scope["kernel"])

        return kernel_of

    @staticmethod
    def _rename(function, name: str):
        function.__name__ = function.__qualname__ = name
        return function


@cache
def identity(source: Any) -> str:
    """16 hexadecimal digits that tell sources apart; those of equal sources are equal, in every run."""
    told = f"{source!r}{' of joints' if getattr(source, 'joints', False) else ''}"
    return hashlib.sha256(told.encode()).hexdigest()[:16]


def unique_name(source: Any, role: str) -> str:
    """A name that tells sources apart and is the same in every run, so that Warp finds its compiled kernels."""
    return f"wb_{source.name}_{source.ndim}d_{identity(source)}_{role}"
