"""What may stand in a config file: each key has a check, and what is wrong is said with its place."""

import argparse
import dataclasses
import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fitting.cli import messages, words
from fitting.priors import LogNormal, Normal, TruncatedNormal, Uniform
from fitting.readers import quoted, suggestion

PRIORS: dict[str, Any] = {
    "normal": Normal,
    "log-normal": LogNormal,
    "uniform": Uniform,
    "truncated": TruncatedNormal,
}


@dataclass(frozen=True)
class Place:
    """Where something stands: the file and the keys that lead there."""

    file: str
    path: str = ""

    def at(self, *keys: str | int) -> "Place":
        """A place within this one: keys of tables, and items of lists, counted from 0 and shown from 1."""
        path = self.path
        for key in keys:
            path += f"[{key + 1}]" if isinstance(key, int) else f".{key}" if path else key
        return Place(self.file, path)

    def error(self, message: str) -> ValueError:
        """What is wrong here, in the words of a config file."""
        return ValueError(": ".join(filter(None, [self.file, self.path, messages.in_config(message)])))


Check = Callable[[Any, Place], Any]
"""Takes what stands at a place, gives what it means, raises a ValueError that says what is expected."""


def table(content: Any, place: Place, keys: Mapping[str, Check], of: str = "") -> dict[str, Any]:
    """A table of known keys, each checked; those that are not given are not in the answer.

    Args:
        content: what stands there.
        place: where.
        keys: the check of each key.
        of: what kind of table it is, if its keys depend on that.

    Raises:
        ValueError: it is no table, a key is unknown, or a check fails.
    """
    if not isinstance(content, dict):
        raise place.error(f"{shown(content)}; expected a table")
    for name in content:
        if name not in keys:
            close = difflib.get_close_matches(name.lower(), keys, n=1)
            hint = f"did you mean {close[0]}?" if close else f"expected one of: {', '.join(keys)}"
            raise place.at(name).error(f"unknown key{of}; {hint}")
    return {name: keys[name](value, place.at(name)) for name, value in content.items()}


def shown(value: Any) -> str:
    """A value as a message shows it: short, and with its type where that may be wrong."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {quoted(value)}"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, dict):
        return "a table"
    return str(value)


def text(value: Any, place: Place) -> str:
    """Some text."""
    if not isinstance(value, str):
        raise place.error(f"{shown(value)}; expected text in quotes")
    if not value.strip() or not value.isprintable():
        raise place.error(f"{shown(value)}; expected some text on one line")
    return value


def flag(value: Any, place: Place) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise place.error(f"{shown(value)}; expected true or false")
    return value


def number(value: Any, place: Place) -> float:
    """A finite number."""
    return float(of_word(words.finite)(value, place))


def of_word(word: Callable[[str], float]) -> Check:
    """A number with the limits that an option of the command line has."""

    def check(value: Any, place: Place) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise place.error(f"{shown(value)}; expected a number")
        typed = repr(value)
        try:
            return word(typed)
        except argparse.ArgumentTypeError as error:
            raise place.error(str(error).replace(f"{typed!r}:", f"{typed};", 1)) from None

    return check


def angle(value: Any, place: Place) -> float:
    """A dihedral angle, degrees."""
    degrees = number(value, place)
    if not 0 < degrees <= 180:
        raise place.error(f"{degrees:g}; expected a dihedral angle above 0 and at most 180 degrees")
    return degrees


def count(value: Any, place: Place) -> int:
    """A whole number of at least 1."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise place.error(f"{shown(value)}; expected a whole number of at least 1")
    return value


def word_or_number(value: Any, place: Place) -> str:
    """What an option takes as a number, a name or a file, as it would be typed."""
    if isinstance(value, str):
        return text(value, place)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise place.error(f"{shown(value)}; expected a number, or the text of a name or a file")
    number(value, place)
    return repr(value)


def choice(*names: str) -> Check:
    """One of some names."""

    def check(value: Any, place: Place) -> str:
        if value not in names:
            close = suggestion(value, names) if isinstance(value, str) else ""
            raise place.error(f"{shown(value)}{close}; expected one of: {', '.join(names)}")
        return str(value)

    return check


def pair(value: Any, place: Place) -> tuple[float, float]:
    """Two numbers, the second larger."""
    low, high = _in_order(value, place, "low < high")
    if low == high:
        raise place.error(f"[{low:g}, {high:g}]; expected [low, high] with low < high")
    return low, high


def span(value: Any, place: Place) -> tuple[float, float]:
    """Two numbers, the second not smaller."""
    return _in_order(value, place, "low ≤ high")


def _in_order(value: Any, place: Place, order: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise place.error(f"{shown(value)}; expected [low, high] with {order}")
    low, high = (number(v, place) for v in value)
    if low > high:
        raise place.error(f"[{low:g}, {high:g}]; expected [low, high] with {order}")
    return low, high


def two(value: Any, place: Place) -> tuple[float, float]:
    """Two numbers, of n and of k."""
    if not isinstance(value, list) or len(value) != 2:
        raise place.error(f"{shown(value)}; expected two numbers, [n, k]")
    n, k = (number(v, place) for v in value)
    return n, k


def one(value: Any, place: Place) -> tuple[float]:
    """One number, of n."""
    return (number(value, place),)


def coefficient(value: Any, place: Place) -> Any:
    """A coefficient of a formula: a number holds it, a range frees it."""
    if isinstance(value, list):
        return pair(value, place)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise place.error(f"{shown(value)}; expected a number (held) or [low, high] (free)")
    return number(value, place)


def many(check: Check, expected: str) -> Check:
    """A list of what passes a check, with at least one item."""

    def checked(value: Any, place: Place) -> tuple[Any, ...]:
        if not isinstance(value, list) or not value:
            raise place.error(f"{shown(value) if value != [] else 'an empty list'}; expected {expected}")
        return tuple(check(v, place.at(i)) for i, v in enumerate(value))

    return checked


def prior(value: Any, place: Place) -> Any:
    """A prior of `fitting.priors`, or None for "none"."""
    kinds = f'expected "none", or a table such as {{ kind = "normal", ... }} of kind {", ".join(PRIORS)}'
    if value == "none":
        return None
    if not isinstance(value, dict) or "kind" not in value:
        raise place.error(f"{'a table without kind' if isinstance(value, dict) else shown(value)}; {kinds}")
    kind = choice(*PRIORS)(value["kind"], place.at("kind"))
    fields = dataclasses.fields(PRIORS[kind])
    known: dict[str, Check] = {"kind": text} | {field.name: number for field in fields}
    given = table(value, place, known, f" of a {kind} prior")
    for field in fields:
        if field.name not in given and field.default is dataclasses.MISSING:
            raise place.at(field.name).error(f"missing; expected a number: a {kind} prior needs it")
    try:
        return PRIORS[kind](**{name: v for name, v in given.items() if name != "kind"})
    except ValueError as error:
        raise place.error(str(error)) from None


def relative_prior(value: Any, place: Place) -> float | None:
    """The standard deviation of a spectrum around the scene's own, as a share of it; None for "none"."""
    if value == "none":
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise place.error(f'{shown(value)}; expected "none", or a standard deviation as a share, such as 0.03')
    return float(of_word(words.positive)(value, place))
