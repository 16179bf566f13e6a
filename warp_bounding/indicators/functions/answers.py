"""A user's function as a shape may rely on it: each answer has the right shape and type, no NaN, and is the same again.

What cannot be relied on is an ``IndicatorError`` in one line that names the function and shows what came.
"""

import copy
import pickle
from collections.abc import Callable

import numpy as np

from warp_bounding.errors import IndicatorError

__all__ = ["Answers", "shown"]

AGAIN = 64  # every so many calls one is asked twice
MOST_AGAIN = 4096  # rows; a larger call is not asked twice
UNSURE = 1e-9  # of the largest answer: numbers that differ by less are the same, in another order of summation


class Answers:
    """A function of arrays, checked.

    Args:
        function: Takes one or two ``(N, n)`` float64 arrays, copies that it may write to.
        what: Its name, for messages.
        name: The shape's name, for messages.
        numbers: Whether it returns ``(N,)`` numbers instead of ``(N,)`` truth values.

    Raises:
        IndicatorError: If it cannot be called.
    """

    def __init__(self, function: Callable, what: str, name: str, *, numbers: bool = False):
        if not callable(function):
            raise IndicatorError(f"{name}: {what} must be a function of arrays, got {function!r}")
        self.function, self.what, self.name, self.numbers = function, what, name, numbers
        self._calls = 0

    def __getstate__(self) -> dict:
        try:
            pickle.dumps(self.function)
        except Exception as error:  # what it holds may raise anything
            needed = "define it in a module, and not as a lambda or in a function"
            raise IndicatorError(f"{self.name}: {self.what} cannot be pickled ({error}); {needed}") from error
        return vars(self)

    def __deepcopy__(self, memo: dict) -> "Answers":
        return Answers(copy.deepcopy(self.function, memo), self.what, self.name, numbers=self.numbers)

    def __call__(self, *arrays: np.ndarray) -> np.ndarray:
        """The answers ``(N,)``, bool or float64, to finite arrays.

        Raises:
            IndicatorError: If the function raises, or its answers cannot be relied on.
        """
        if not len(arrays[0]):
            return np.zeros(0, dtype=np.float64 if self.numbers else bool)
        answer = self._ask(arrays)
        self._calls += 1
        if self._calls % AGAIN == 1 and len(answer) <= MOST_AGAIN:
            self.compare(answer, arrays, np.arange(len(answer)))
        return answer

    def compare(self, answer: np.ndarray, arrays: tuple[np.ndarray, ...], order: np.ndarray) -> None:
        """Ask again, with the rows in another order.

        Raises:
            IndicatorError: If a row gets another answer.
        """
        again = self._ask([array[order] for array in arrays])
        before = answer[order]
        if self.numbers:
            with np.errstate(invalid="ignore"):
                finite = np.abs(before[np.isfinite(before)])
                near = np.abs(again - before) <= UNSURE * finite.max(initial=0.0)
            changed = ~(near | (again == before))
        else:
            changed = again != before
        if changed.any():
            row = int(np.argmax(changed))
            at = " to ".join(shown(array[order[row]]) for array in arrays)
            raise IndicatorError(
                f"{self.name}: {self.what} must answer each point on its own and always the same, got "
                f"{before[row]} and then {again[row]} at {at}"
            )

    def _ask(self, arrays) -> np.ndarray:
        count = len(arrays[0])
        try:
            answer = self.function(*(np.array(array, dtype=np.float64, order="C") for array in arrays))
        except Exception as error:
            reason = " ".join(str(error).split())
            raise IndicatorError(
                f"{self.name}: {self.what} raised {type(error).__name__} for {count} points: {reason}"
            ) from error
        answer = np.asarray(answer)
        kinds, needed = ("iu", "float64") if self.numbers else ("", "bool")
        right = answer.dtype == np.dtype(needed) or answer.dtype.kind in kinds
        if answer.shape != (count,) or not right:
            got = f"{answer.dtype} of shape {answer.shape}"
            raise IndicatorError(f"{self.name}: {self.what} must return {needed} of shape ({count},), got {got}")
        answer = answer.astype(needed)
        if self.numbers and np.isnan(answer).any():
            row = int(np.argmax(np.isnan(answer)))
            raise IndicatorError(f"{self.name}: {self.what} must return numbers, got NaN at {shown(arrays[0][row])}")
        return answer


def shown(x: np.ndarray) -> str:
    """A point in a message, with all digits."""
    return f"({', '.join(repr(float(each)) for each in x)})"
