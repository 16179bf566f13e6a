"""Time motions in C and Python: `python benchmarks/motions_header.py arm.urdf --srdf arm.srdf`.

Prints microseconds a motion and a configuration, and how many answers differ.
"""

import argparse
import ctypes
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import warp_bounding as wb

BOXES, COUNT, SINGLE, ROUNDS = 20, 4000, 500, 5
ASK = """
#include <stddef.h>
#include "arm.h"
#ifdef __cplusplus
extern "C"
#endif
void ask(const double *a, const double *b, int count, int *clear, int *states) {
    for (int i = 0; i < count; ++i, a += N, b += N) {
        if (clear) clear[i] = arm_segment(a, b, NULL);
        if (states) states[i] = arm_configuration(a);
    }
}
"""


def seconds(call) -> float:
    """The least of a few rounds, of the process."""
    found = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        call()
        found.append(time.process_time() - begin)
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("urdf", type=Path)
    parser.add_argument("--srdf", type=Path)
    options = parser.parse_args()
    rng, arm = np.random.default_rng(0), wb.arms.load_urdf(options.urdf, srdf=options.srdf)
    places = rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.0], (BOXES, 3))
    places = places[np.abs(places[:, :2]).max(axis=1) > 0.3]  # not in the base
    motions = wb.arms.Motions(arm, [wb.arms.Body.box(x - 0.05, x + 0.05) for x in places])
    q0 = rng.uniform(arm.lower, arm.upper, (20 * COUNT, len(arm.free)))
    q0 = np.ascontiguousarray(q0[motions.configurations(q0) == 0][:COUNT])
    q1 = np.clip(q0 + rng.normal(0, 0.15, q0.shape), arm.lower, arm.upper)
    singles = [(q0[i : i + 1], q1[i : i + 1]) for i in range(SINGLE)]
    clear, states = motions.segments(q0, q1)[0], np.zeros(len(q0), np.int32)
    found = np.zeros_like(states)
    print(f"{motions}, {len(q0)} motions of {np.linalg.norm(q1 - q0, axis=1).mean():.2f} rad, {clear.mean():.0%} free")
    rows = {
        "Python, a batch": (seconds(lambda: motions.segments(q0, q1)), seconds(lambda: motions.configurations(q0))),
        "Python, single calls": (
            seconds(lambda: [motions.segments(*each) for each in singles]) * len(q0) / SINGLE,
            seconds(lambda: [motions.configurations(each[0]) for each in singles]) * len(q0) / SINGLE,
        ),
    }
    ends, answers = (q0.ctypes.data, q1.ctypes.data), (found.ctypes.data, states.ctypes.data)
    with tempfile.TemporaryDirectory() as folder:
        motions.export(Path(folder) / "arm.h")
        (Path(folder) / "ask.c").write_text(ASK)
        for compiler in ("gcc", "g++", "clang", "clang++"):
            language, library = "c++" if "++" in compiler else "c", f"{folder}/{compiler}.so"
            line = [compiler, "-O3", "-march=native", "-shared", "-fPIC", f"-DN={q0.shape[1]}", "-x", language]
            subprocess.run([*line, "ask.c", "-o", library, "-lm"], cwd=folder, check=True)
            ask = ctypes.CDLL(library).ask
            ask.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
            rows[f"{language.upper()}, {compiler}"] = (
                seconds(lambda ask=ask: ask(*ends, len(q0), answers[0], None)),
                seconds(lambda ask=ask: ask(*ends, len(q0), None, answers[1])),
            )
            print(f"{compiler}: {(found != clear).sum()} of {len(q0)} motions answered otherwise than in Python")
    print("\n| | motion, us | configuration, us |\n|---|--:|--:|")
    for name, times in rows.items():
        print(f"| {name} | {' | '.join(f'{1e6 * each / len(q0):.1f}' for each in times)} |")


if __name__ == "__main__":
    main()
