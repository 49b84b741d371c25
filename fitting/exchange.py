"""Which few of many: greedy choice, exchange of single members, and trying all sets."""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

Order = Callable[[np.ndarray], np.ndarray]
"""From sets of candidates, shape (N, S), to keys, shape (N, 2): compared by the first number, then the second."""

MOST_SETS = 100_000
"""Sets that ``exhaustive`` tries at most."""

_SAME = 1e-9
_PASSES = 100


def greedy(order: Order, offered: Sequence[int], count: int) -> list[int]:
    """One candidate after the other, each the best one beside those before it."""
    chosen: list[int] = []
    while len(chosen) < count:
        left = [c for c in offered if c not in chosen]
        sets = np.array([[*chosen, c] for c in left])
        chosen.append(left[best(order(sets))])
    return chosen


def exchange(order: Order, offered: Sequence[int], start: Sequence[int]) -> list[int]:
    """Swap one chosen candidate for another one, the best swap first, until none improves the set."""
    chosen = list(start)
    now = order(np.array([chosen]))[0]
    for _ in range(_PASSES):
        left = [c for c in offered if c not in chosen]
        swapped = [[*chosen[:i], c, *chosen[i + 1 :]] for i in range(len(chosen)) for c in left]
        if not swapped:
            break
        keys = order(np.array(swapped))
        first = best(keys)
        if not better(keys[first], now):
            break
        chosen, now = swapped[first], keys[first]
    return chosen


def exhaustive(order: Order, offered: Sequence[int], count: int) -> list[int]:
    """The best of all sets.

    Raises:
        ValueError: there are too many.
    """
    total = math.comb(len(offered), count)
    if total > MOST_SETS:
        raise ValueError(
            f"method is 'exhaustive' for {total} sets of {count} out of {len(offered)} candidates; expected at "
            f"most {MOST_SETS}: use 'exchange'"
        )
    sets = np.array(list(itertools.combinations(offered, count)))
    return [int(c) for c in sets[best(order(sets))]]


def best(keys: np.ndarray) -> int:
    """Place of the least key; the first one of those that agree but for rounding."""
    least = keys[:, 0] <= keys[:, 0].min() + _SAME
    second = np.where(least, keys[:, 1], np.inf)
    return int(np.argmax(second <= second.min() + _SAME))


def better(new: np.ndarray, old: np.ndarray) -> bool:
    """Whether a key is less than another one, by more than rounding."""
    if abs(new[0] - old[0]) > _SAME:
        return bool(new[0] < old[0])
    return bool(new[1] < old[1] - _SAME)
