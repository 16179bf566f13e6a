"""Warp's decorators for functions and kernels that a factory makes around native source, one for each size.

Large kernels ask for two dimensions, ``i, _ = wp.tid()``, of which the second is 1: of those that ask for one Warp
compiles a second copy, for arrays without gaps, which takes as long again.
"""

import hashlib
import linecache
import platform
import re
from functools import cache
from importlib.resources import files
from string import Template
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

Numbers = wp.array(dtype=wp.float32)


@cache
def native_text(name: str) -> SimpleNamespace:
    """The parts of a file of ``warp_bounding/native``, by name.

    A part begins behind a line ``/// NAME`` and lines ``///`` that explain it. Errors of the compiler name the file's
    lines, also behind a ``$name`` in whose place another text stands.
    """
    parts, filled = {}, True
    whole = files("warp_bounding").joinpath("native", name).read_text("utf-8") + "\n"
    for number, line in enumerate(whole.splitlines(), 1):
        if header := re.fullmatch(r"/// ([A-Z0-9_]+):?", line):
            parts[header[1]], filled = "", True
        elif parts and not line.startswith("///"):
            place = f'#line {number} "warp_bounding/native/{name}"\n' * filled
            parts[next(reversed(parts))] += f"\n{place}{line}"
            filled = bool(re.fullmatch(r"\s*\$\w+", line))
    return SimpleNamespace(**parts)


def fill(text: str, **values: object) -> str:
    """C text with these values in the places of its ``$names``."""
    return Template(text).substitute(values)


def constants(**values: int) -> str:
    """C declaration of integer constants, by name."""
    return f"enum {{ {', '.join(f'{name} = {int(value)}' for name, value in values.items())} }};"


@cache
def vector_type(length: int) -> Any:
    """A vector of so many float32 numbers, Warp's own where it has a name."""
    own = {2: wp.vec2, 3: wp.vec3, 4: wp.vec4}
    return own[length] if length in own else wp.types.vector(length=length, dtype=wp.float32)


def literal(value: float) -> str:
    """A float32 constant in C, exactly; others are rounded to one."""
    mantissa, exponent = float(np.float32(value)).hex().split("p")
    return f"{mantissa.rstrip('0').rstrip('.')}p{exponent}f"


def constant(value: float) -> str:
    """A float64 constant in C, exactly."""
    return float(value).hex().replace("inf", "INFINITY")


# LLVM's own thresholds; Warp's are far higher. What these compile is no slower, in a third to a half of the time; arms
# and motions are slower, and keep Warp's.
INLINING = "-mllvm=-inline-threshold=225 -mllvm=-inline-cold-callsite-threshold=45"


def module_options(inlining: str = INLINING) -> dict[str, str]:
    """Options of a module: what is inlined, and 512-bit registers where there are any.

    On some processors the compiler prefers 256 bits.

    Modules that are used together have the same: for other flags Warp parses its own header anew, which takes seconds.
    """
    flags = getattr(wp.config, "cpu_compiler_flags", None)
    if flags is None:
        return {}
    wide = ["-mprefer-vector-width=512"] if platform.machine() in ("x86_64", "AMD64") else []
    less = [inlining] if inlining and "-inline-threshold" in flags else []
    return {"cpu_compiler_flags": " ".join([flags, *wide, *less])}


STRICT = """
#if !defined(__CUDA_ARCH__)
#if defined(__FAST_MATH__) || __FINITE_MATH_ONLY__
#error "warp_bounding: proofs are about IEEE arithmetic, which -ffast-math (cpu_compiler_flags) gives up; leave it out"
#endif
#pragma clang fp reassociate(off) reciprocal(off)
#endif
"""


def _type_name(kind: Any) -> str:
    name = getattr(kind, "__name__", None) or getattr(kind, "key", str(kind)).rpartition(".")[2]
    return f"vector of {kind._length_} {kind._wp_scalar_type_.__name__}" if name == "vec_t" else name


class named:  # noqa: N801 (used like a function: `@named(name).kernel`)
    """Warp's decorators for functions made in a factory; Warp would take equal names for overloads of one function.

    Warp reads the return type of a native function only under a decorator that is spelled ``x.func_native(...)``.
    """

    def __init__(self, name: str):
        self.name = name

    def func_native(self, snippet: str):
        """``wp.func_native`` under this name; the compiler may neither reorder nor approximate (``STRICT``)."""

        def decorate(function):
            made = wp.func_native(STRICT + snippet)(self._rename(function, f"{self.name}_native"))
            overload_of = made.get_overload

            def get_overload(kinds, named_kinds):
                if (found := overload_of(kinds, named_kinds)) is not None and "return" in function.__annotations__:
                    found.adj.arg_types["return"] = function.__annotations__["return"]
                return found

            made.get_overload = get_overload  # Warp forgets the return type where an argument is ``Any``
            return made

        return decorate

    def func(self, function):
        """``wp.func`` under this name, which says what it takes where a kernel gives it something else."""
        made = wp.func(self._rename(function, self.name))
        overload_of, role = made.get_overload, self.name.rpartition("_")[2]

        def get_overload(kinds, named_kinds):
            if (found := overload_of(kinds, named_kinds)) is None:
                takes = ", ".join(f"{name}: {_type_name(kind)}" for name, kind in made.input_types.items())
                got = ", ".join(map(_type_name, [*kinds, *named_kinds.values()]))
                raise TypeError(f"{role} takes ({takes}), got ({got}); convert float64 by wp.vec3(x) or its like")
            return found

        made.get_overload = get_overload  # Warp's own message names neither
        return made

    def kernel(self, function, inlining: str = ""):
        """``wp.kernel`` under this name, in a module of its own."""
        options = module_options(inlining)
        named_function = self._rename(function, self.name)
        return wp.kernel(named_function, enable_backward=False, module="unique", module_options=options)

    def block_kernel(self, snippet: str, inlining: str = INLINING):
        """A kernel of which each thread runs ``snippet`` on one block; a stub that is decorated names the arguments.

        One of them is the int ``block``: to the snippet the number of its own block, to the kernel, whose other
        arguments are the same, that of the launch's first.
        """

        def kernel_of(stub):
            arguments = stub.__annotations__
            passed = ", ".join("block + i" if name == "block" else name for name in arguments)
            text = f"def kernel({', '.join(arguments)}):\n    i, j = wp.tid()\n    native({passed})\n"
            file = f"<{self.name}>"
            linecache.cache[file] = len(text), None, text.splitlines(True), file  # Warp reads the text of a kernel
            scope = {"native": self.func_native(snippet)(stub), "wp": wp}
            exec(compile(text, file, "exec"), scope)
            scope["kernel"].__annotations__ = arguments
            return self.kernel(scope["kernel"], inlining)

        return kernel_of

    @staticmethod
    def _rename(function, name: str):
        function.__name__ = function.__qualname__ = name
        return function


@cache
def identity(source: Any) -> str:
    """16 hexadecimal digits that tell sources apart; those of equal sources are equal, in every run."""
    reported = f"{source!r}{' of joints' if getattr(source, 'joints', False) else ''}"
    return hashlib.sha256(reported.encode()).hexdigest()[:16]


def unique_name(source: Any, role: str) -> str:
    """A name that tells sources apart and is the same in every run, so that Warp finds its compiled kernels."""
    return f"wb_{source.name}_{source.ndim}d_{identity(source)}_{role}"
