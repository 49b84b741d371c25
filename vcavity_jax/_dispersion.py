"""Dispersion: n or k as a function of wavelength, from a table or a formula of refractiveindex.info.

References:
    [Polyanskiy2024] M. N. Polyanskiy, Refractiveindex.info database of optical constants,
    Sci. Data 11, 94 (2024), and the document "Dispersion formulas" of that database.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NUMBER = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))(?:[eE]([+-]?[0-9]{1,3}))?")


@dataclass(frozen=True)
class Curve:
    """One quantity, "n" or "k", over its range of wavelengths, and the line of the file that gives it.

    `evaluate` takes wavelengths in nanometers within the range, shape (L,), and returns values of that shape.
    """

    quantity: str
    line: int
    lower_nm: float
    upper_nm: float
    evaluate: Callable[[Array], Array]
    zero: bool = False


def fail(label: str, line: int | None, problem: str) -> NoReturn:
    """Raise a ValueError of one line that names the file, the line in it if there is one, and the problem."""
    place = label if line is None else f"{label}, line {line}"
    raise ValueError(" ".join(f"{place}: {problem}".split()))


def _number(text: str, shift: int = 0) -> float:
    """The number written in `text` times 10^shift, correctly rounded: 0.4368 µm is exactly 436.8 nm."""
    match = _NUMBER.fullmatch(text)
    value = float(f"{match[1]}e{int(match[2] or 0) + shift}") if match else np.nan
    if not np.isfinite(value):
        raise ValueError(f"{text[:40]!r} is not a number")
    return value


def tabulated_curves(
    label: str, line: int, quantities: str, rows: Iterable[tuple[int, list[str]]], shift: int
) -> list[Curve]:
    """Curves of a table, linear in wavelength between its rows; k <= 0 throughout is conjugated.

    Args:
        label: name of the file, for messages.
        line: line of the file at which the table begins.
        quantities: "n", "k" or "nk", the columns after the wavelength.
        rows: (line of the file, cells) of each row.
        shift: power of ten that takes the wavelengths to nanometers, 3 for micrometers.

    Returns:
        One curve for each of the quantities.

    Raises:
        ValueError: a row with other columns or without numbers, wavelengths that do not increase strictly
            or are not above 0, n <= 0, k of both signs, or no row at all.
    """
    table: list[list[float]] = []
    sign = 0.0
    for at, cells in rows:
        if len(cells) != 1 + len(quantities):
            columns = ", ".join(("wavelength", *quantities))
            fail(label, at, f"found {len(cells)} columns; expected {1 + len(quantities)}: {columns}")
        try:
            row = [_number(cells[0], shift), *map(_number, cells[1:])]
        except ValueError as error:
            fail(label, at, f"{error}; expected numbers only")
        if row[0] <= 0:
            fail(label, at, f"wavelength {row[0]:.10g} nm; expected wavelengths above 0")
        if table and row[0] <= table[-1][0]:
            problem = "repeats the row before" if row[0] == table[-1][0] else f"follows {table[-1][0]:.10g} nm"
            fail(label, at, f"wavelength {row[0]:.10g} nm {problem}; expected strictly increasing wavelengths")
        if quantities[0] == "n" and row[1] <= 0:
            fail(label, at, f"n = {row[1]:g}; expected n > 0")
        if quantities[-1] == "k":
            if row[-1] * sign < 0:
                fail(label, at, f"k = {row[-1]:g} changes sign; expected all k >= 0 or all k <= 0")
            sign = sign or float(np.sign(row[-1]))
        table.append(row)
    if not table:
        fail(label, line, "the table has no rows; expected at least one")
    data = np.array(table)
    return [_linear(quantity, line, data[:, 0], data[:, i]) for i, quantity in enumerate(quantities, start=1)]


def _linear(quantity: str, line: int, wavelengths_nm: Array, values: Array) -> Curve:
    magnitudes = np.abs(values)  # n is positive already; a table of n − ik is conjugated

    def evaluate(nm: Array) -> Array:
        return np.interp(nm, wavelengths_nm, magnitudes)

    ends = float(wavelengths_nm[0]), float(wavelengths_nm[-1])
    return Curve(quantity, line, *ends, evaluate, zero=not magnitudes.any())


# In the sums of formulas 1 to 6 the coefficients c[1::2] stand before terms with the parameters c[2::2].


def _sellmeier(w: Array, c: Array) -> Array:
    """Formula 1: n² = 1 + C1 + Σ C2 λ²/(λ² − C3²)."""
    return np.sqrt(1 + c[0] + c[1::2] @ (w**2 / (w**2 - c[2::2, None] ** 2)))


def _sellmeier_2(w: Array, c: Array) -> Array:
    """Formula 2: n² = 1 + C1 + Σ C2 λ²/(λ² − C3)."""
    return np.sqrt(1 + c[0] + c[1::2] @ (w**2 / (w**2 - c[2::2, None])))


def _polynomial(w: Array, c: Array) -> Array:
    """Formula 3: n² = C1 + Σ C2 λ^C3."""
    return np.sqrt(c[0] + c[1::2] @ w ** c[2::2, None])


def _refractiveindex_info(w: Array, c: Array) -> Array:
    """Formula 4: n² = C1 + C2 λ^C3/(λ² − C4^C5) + C6 λ^C7/(λ² − C8^C9) + Σ C10 λ^C11."""
    poles = c[1:9].reshape(-1, 4, 1)
    fractions = poles[:, 0] * w ** poles[:, 1] / (w**2 - poles[:, 2] ** poles[:, 3])
    return np.sqrt(c[0] + fractions.sum(axis=0) + c[9::2] @ w ** c[10::2, None])


def _cauchy(w: Array, c: Array) -> Array:
    """Formula 5: n = C1 + Σ C2 λ^C3."""
    return c[0] + c[1::2] @ w ** c[2::2, None]


def _gases(w: Array, c: Array) -> Array:
    """Formula 6: n = 1 + C1 + Σ C2/(C3 − λ^−2)."""
    return 1 + c[0] + c[1::2] @ (1 / (c[2::2, None] - w**-2))


def _herzberger(w: Array, c: Array) -> Array:
    """Formula 7: n = C1 + C2 L + C3 L² + C4 λ² + C5 λ⁴ + C6 λ⁶ with L = 1/(λ² − 0.028)."""
    pole = 1 / (w**2 - 0.028)
    return sum(a * term for a, term in zip(c, (1, pole, pole**2, w**2, w**4, w**6), strict=False))


def _retro(w: Array, c: Array) -> Array:
    """Formula 8: (n² − 1)/(n² + 2) = C1 + C2 λ²/(λ² − C3) + C4 λ²."""
    right = c[0] + c[1] * w**2 / (w**2 - c[2]) + c[3] * w**2
    return np.sqrt((1 + 2 * right) / (1 - right))


def _exotic(w: Array, c: Array) -> Array:
    """Formula 9: n² = C1 + C2/(λ² − C3) + C4 (λ − C5)/((λ − C5)² + C6)."""
    return np.sqrt(c[0] + c[1] / (w**2 - c[2]) + c[3] * (w - c[4]) / ((w - c[4]) ** 2 + c[5]))


_Formula = Callable[[Array, Array], Array]
# Each takes wavelengths in micrometers and the coefficients C1, C2, ..., of which it has one of the counts.
_FORMULAS: dict[int, tuple[_Formula, Sequence[int]]] = {
    1: (_sellmeier, range(1, 18, 2)),
    2: (_sellmeier_2, range(1, 18, 2)),
    3: (_polynomial, range(1, 18, 2)),
    4: (_refractiveindex_info, (1, 5, 9, 11, 13, 15, 17)),
    5: (_cauchy, range(1, 12, 2)),
    6: (_gases, range(1, 12, 2)),
    7: (_herzberger, range(3, 7)),
    8: (_retro, (4,)),
    9: (_exotic, (6,)),
}


def formula_curve(formula: int, line: int, ends: Sequence[str], coefficients: Sequence[str]) -> Curve:
    """Curve of n from a dispersion formula; NaN or infinite where the formula has no real value.

    Args:
        formula: number of the formula, 1 to 9.
        line: line of the file that gives it.
        ends: shortest and longest wavelength in micrometers, as written.
        coefficients: C1, C2, ... in powers of micrometers, as written.

    Returns:
        The curve.

    Raises:
        ValueError: an end or coefficient is not a number, the ends are no range of wavelengths, or the
            formula does not take that many coefficients.
    """
    values = np.array([_number(text) for text in coefficients])
    function, counts = _FORMULAS[formula]
    if len(values) not in counts:
        raise ValueError(f"found {len(values)} coefficients; expected {', '.join(map(str, counts))}")
    range_nm = [_number(text, 3) for text in ends]
    if len(range_nm) != 2 or not 0 < range_nm[0] < range_nm[1]:
        raise ValueError(
            f"wavelength_range is {' '.join(ends)[:40]!r}; expected 'shortest longest' in micrometers"
        )

    def evaluate(wavelengths_nm: Array) -> Array:
        # The caller refuses NaN with a message that names the wavelength: a warning would only precede it.
        with np.errstate(all="ignore"):
            return function(wavelengths_nm / 1000, values)

    return Curve("n", line, range_nm[0], range_nm[1], evaluate)
