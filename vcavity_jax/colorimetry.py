"""From reflectance spectra to color: tristimulus values, CIELAB, sRGB and CIEDE2000, differentiable.

Gradients are finite everywhere, also at black, at neutral grays and for equal colors; each function says what is
returned where the formula itself has none. The tables of the CIE come with the package (data/cie).
"""

import functools
import importlib.resources
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import ArrayLike as Wavelengths
from numpy.typing import NDArray

Observer = Literal["CIE 1931", "CIE 1964"]
# fmt: off
Illuminant = Literal[
    "A", "C", "D50", "D55", "D65", "D75", "E",
    "FL1", "FL2", "FL3", "FL4", "FL5", "FL6", "FL7", "FL8", "FL9", "FL10", "FL11", "FL12",
    "FL3.1", "FL3.2", "FL3.3", "FL3.4", "FL3.5", "FL3.6", "FL3.7", "FL3.8", "FL3.9", "FL3.10", "FL3.11", "FL3.12",
    "FL3.13", "FL3.14", "FL3.15",
    "LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2",
]
# fmt: on
Practice = Literal["ASTM E308", "sum"]
OBSERVERS: tuple[Observer, ...] = get_args(Observer)
PRACTICES: tuple[Practice, ...] = get_args(Practice)
ILLUMINANTS: tuple[Illuminant, ...] = get_args(Illuminant)

_COARSEST_NM = 20.0
_VISIBLE_NM = (400.0, 700.0)
_PRACTICE_NM = np.arange(360.0, 781.0)
_PRACTICE_STEPS = (1, 5, 10, 20)
# Wavelengths that single precision rounded are still equally spaced, and still inside.
_EDGE = 1e-6


def _srgb_matrix() -> NDArray[np.float64]:
    """From tristimulus values in units of sRGB's white to linear sRGB; every row sums to 1."""
    x, y = np.array([0.64, 0.30, 0.15]), np.array([0.33, 0.60, 0.06])
    primaries = np.stack([x / y, np.ones(3), (1 - x - y) / y])
    white = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
    return np.linalg.inv(primaries * np.linalg.solve(primaries, white)) * white


_SRGB = _srgb_matrix()


def xyz(
    reflectance: Float[ArrayLike, "*batch wavelengths"],
    wavelengths_nm: Wavelengths,
    illuminant: Illuminant = "D65",
    observer: Observer = "CIE 1931",
    *,
    partial: bool = False,
    practice: Practice | None = None,
) -> Float[Array, "*batch 3"]:
    """Tristimulus values X, Y, Z of a reflecting surface; Y = 100 for the perfect diffuser.

    X = 100 Σ R S x̄ / Σ S ȳ and so on, with the illuminant S and the color-matching functions, in one of two
    practices:

    - "ASTM E308", for 1, 5, 10 and 20 nm: the sum over 360 to 780 nm, where 10 and 20 nm data are interpolated
      to 1 nm by the standard's polynomials, and end values stand for what was not measured.
    - "sum", for any equal step: over the wavelengths given. It is compared with others' fairly only over the same
      wavelengths.

    Tables are interpolated linearly: observers between 1 nm, illuminants between 5 nm, as the CIE defines them.

    Args:
        reflectance: reflectance or reflectance factor, fraction, shape (..., L).
        wavelengths_nm: nm, shape (L,), known and equally spaced by at most 20 nm, rising or falling.
        illuminant: one of ``ILLUMINANTS``.
        observer: one of ``OBSERVERS``: "CIE 1931" sees a field of 2°, "CIE 1964" one of 10°.
        partial: accept wavelengths that do not cover 400 to 700 nm. The result is then a color of what is there
            and comparable only with colors over the same wavelengths.
        practice: one of ``PRACTICES``; None for ASTM E308 where the wavelengths are multiples of their step of 1,
            5, 10 or 20 nm (of 10 nm for 20), else the sum.

    Returns:
        X, Y, Z in the last axis, shape (..., 3).

    Raises:
        ValueError: an unknown illuminant, observer or practice; wavelengths that are not equally spaced, too
            coarse, outside the tables, or do not cover the visible range; a spectrum of another length.

    References:
        [ASTME308]; [CIE15, section 7.1]; [SaintPierre2020, section 2.5] takes the sum.
    """
    weights = _weights(_checked_wavelengths(wavelengths_nm, partial), illuminant, observer, practice)
    spectrum = _real(reflectance)
    if spectrum.ndim == 0 or spectrum.shape[-1] != weights.shape[0]:
        raise ValueError(
            f"a reflectance of shape {spectrum.shape} does not fit {weights.shape[0]} wavelengths: "
            "expected these in its last axis"
        )
    return jnp.matmul(spectrum, jnp.asarray(weights, spectrum.dtype), precision="highest")


def white(
    wavelengths_nm: Wavelengths,
    illuminant: Illuminant = "D65",
    observer: Observer = "CIE 1931",
    *,
    partial: bool = False,
    practice: Practice | None = None,
) -> Float[Array, "3"]:
    """Tristimulus values of the perfect diffuser, over the same wavelengths as the colors that refer to it.

    Args:
        wavelengths_nm: as for ``xyz``.
        illuminant: as for ``xyz``.
        observer: as for ``xyz``.
        partial: as for ``xyz``.
        practice: as for ``xyz``.

    Returns:
        X, Y, Z with Y = 100, shape (3,).

    Raises:
        ValueError: as ``xyz``.
    """
    ones = jnp.ones(np.shape(wavelengths_nm))
    return xyz(ones, wavelengths_nm, illuminant, observer, partial=partial, practice=practice)


def lab(xyz: Float[ArrayLike, "*batch 3"], white: Float[ArrayLike, "*#batch 3"]) -> Float[Array, "*batch 3"]:
    """CIE 1976 L*, a*, b*.

    L* = 116 f(Y) - 16, a* = 500 (f(X) - f(Y)), b* = 200 (f(Y) - f(Z)) with X, Y, Z in units of the white;
    f(t) = ∛t above (6/29)³ and the straight line t / (3 (6/29)²) + 4/29 below, also for t < 0.

    Args:
        xyz: tristimulus values, shape (..., 3).
        white: those of the perfect diffuser in the same light (``white``), in the same units, shape (3,).

    Returns:
        L* from 0 to 100, a*, b*, shape (..., 3).

    References:
        [CIE15, section 8.2.1].
    """
    ratio = _real(xyz) / _real(white)
    edge = 6 / 29
    bright = ratio > edge**3
    # ``where`` alone does not shield the gradient: the root's is infinite at black.
    root = jnp.cbrt(jnp.where(bright, ratio, jnp.ones_like(ratio)))
    f = jnp.where(bright, root, ratio / (3 * edge**2) + 4 / 29)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return jnp.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def lch(lab: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Lightness, chroma and hue angle: L*, C* = √(a*² + b*²), h = atan2(b*, a*).

    At exactly zero chroma the hue is 0 and the gradients of C* and h are returned as 0.

    Args:
        lab: L*, a*, b*, shape (..., 3).

    Returns:
        L*, C*, h with h in radians from 0 to 2π, shape (..., 3).

    References:
        [CIE15, section 8.2.1.2].
    """
    lab = _real(lab)
    a, b = lab[..., 1], lab[..., 2]
    return jnp.stack([lab[..., 0], _length(a, b), _hue(a, b)], axis=-1)


def srgb(
    xyz: Float[ArrayLike, "*batch 3"], white: Float[ArrayLike, "*#batch 3"] | None = None, *, clip: bool = False
) -> Float[Array, "*batch 3"]:
    """Colors in sRGB with its nonlinear encoding, 0 to 1 for what a display can show.

    X, Y and Z are each scaled from the given white to that of sRGB, so that the perfect diffuser becomes
    (1, 1, 1) and grays stay gray. This is what passing through CIELAB to the white of sRGB does, too
    [SaintPierre2020, section 3.5].

    The encoding is linear below 0.0031308, also for negative values (colors outside the gamut), and a power
    above, also above 1. Its gradient is finite everywhere. The matrix follows exactly from the chromaticities of
    the standard, which prints it rounded to four digits.

    Args:
        xyz: tristimulus values, shape (..., 3).
        white: those of the perfect diffuser in the same light, shape (3,); by default the white of sRGB itself
            (D65, Y = 100).
        clip: to 0 to 1, for display; the gradient is 0 where it clips.

    Returns:
        R, G, B, shape (..., 3).

    References:
        [IEC61966-2-1].
    """
    tristimulus = _real(xyz)
    if white is None:
        white = 100 * np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
    ratio = tristimulus / _real(white, tristimulus.dtype)
    x, y, z = ratio[..., 0], ratio[..., 1], ratio[..., 2]
    # Rows that sum to 1, written so that grays come out gray to the last digit.
    linear = jnp.stack([y + float(row[0]) * (x - y) + float(row[2]) * (z - y) for row in _SRGB], axis=-1)
    bright = linear > 0.0031308
    power = jnp.where(bright, linear, jnp.ones_like(linear)) ** (1 / 2.4)
    encoded = jnp.where(bright, 1 + 1.055 * (power - 1), 12.92 * linear)
    return jnp.clip(encoded, 0, 1) if clip else encoded


def delta_e_76(lab1: Float[ArrayLike, "*#batch 3"], lab2: Float[ArrayLike, "*#batch 3"]) -> Float[Array, "..."]:
    """Color difference ΔE*ab, the distance in CIELAB; its gradient for equal colors is returned as 0.

    Args:
        lab1: L*, a*, b*, shape (..., 3).
        lab2: the same of the other color; both broadcast.

    Returns:
        ΔE*ab ≥ 0, shape (...).

    References:
        [CIE15, section 8.2.1.3].
    """
    return _root(jnp.sum((_real(lab1) - _real(lab2)) ** 2, axis=-1))


def delta_e_94(lab1: Float[ArrayLike, "*#batch 3"], lab2: Float[ArrayLike, "*#batch 3"]) -> Float[Array, "..."]:
    """Color difference ΔE*94 for graphic arts, k_L = 1, K₁ = 0.045, K₂ = 0.015; gradients as of ``delta_e_2000``.

    Args:
        lab1: L*, a*, b* of the reference, shape (..., 3): it is not symmetric.
        lab2: the same of the sample; both broadcast.

    Returns:
        ΔE*94 ≥ 0, shape (...).

    References:
        [CIE15, section 8.2.3]: superseded by CIEDE2000, but still asked for.
    """
    first, second = jnp.broadcast_arrays(_real(lab1), _real(lab2))
    chroma = _length(first[..., 1], first[..., 2])
    step = _length(second[..., 1], second[..., 2]) - chroma
    light, a, b = (first[..., i] - second[..., i] for i in range(3))
    hue = jnp.maximum(a**2 + b**2 - step**2, 0)
    return _root(light**2 + (step / (1 + 0.045 * chroma)) ** 2 + hue / (1 + 0.015 * chroma) ** 2)


def delta_e_2000(lab1: Float[ArrayLike, "*#batch 3"], lab2: Float[ArrayLike, "*#batch 3"]) -> Float[Array, "..."]:
    """Color difference ΔE₀₀ (CIEDE2000) with k_L = k_C = k_H = 1.

    It jumps, by its definition, where two hues are opposite. Its gradient is infinite or has no direction for
    equal colors and at exactly zero chroma; there the part without a limit is returned as 0.

    Args:
        lab1: L*, a*, b*, shape (..., 3).
        lab2: the same of the other color; both broadcast.

    Returns:
        ΔE₀₀ ≥ 0, shape (...).

    References:
        [Sharma2005]; [CIE15, section 8.3.1].
    """
    return _root(jnp.sum(components_2000(lab1, lab2) ** 2, axis=-1))


def components_2000(
    lab1: Float[ArrayLike, "*#batch 3"], lab2: Float[ArrayLike, "*#batch 3"]
) -> Float[Array, "... 3"]:
    """Three numbers whose squares add up to ΔE₀₀²: of lightness, of chroma (turned by the rotation), of hue.

    They are smooth where two colors are equal and ΔE₀₀ itself is not: residuals for least squares.

    Args:
        lab1: L*, a*, b*, shape (..., 3).
        lab2: the same of the other color; both broadcast.

    Returns:
        Signed components, shape (..., 3).
    """
    return _difference(*jnp.broadcast_arrays(_real(lab1), _real(lab2)))


@jax.jit
def _difference(first: Float[Array, "*batch 3"], second: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    l1, a1, b1 = first[..., 0], first[..., 1], first[..., 2]
    l2, a2, b2 = second[..., 0], second[..., 1], second[..., 2]
    mean_chroma = (_length(a1, b1) + _length(a2, b2)) / 2
    stretch = 1.5 - 0.5 * _saturation(mean_chroma)
    a1, a2 = stretch * a1, stretch * a2
    c1, c2, h1, h2 = _length(a1, b1), _length(a2, b2), _hue(a1, b1), _hue(a2, b2)
    colored = c1 * c2 > 0

    # |h₂ - h₁| ≤ 180°, also where the hues are opposite but for rounding.
    turn = h2 - h1
    near = jnp.abs(turn) <= np.pi * (1 + 8 * float(jnp.finfo(turn.dtype).eps))
    full = jnp.where(near, jnp.zeros_like(turn), 2 * jnp.pi * jnp.sign(turn))
    turn = turn - full
    shift = jnp.where(h1 + h2 < 2 * jnp.pi, jnp.ones_like(turn), -jnp.ones_like(turn)) * jnp.abs(full) / 2
    hue = jnp.where(colored, (h1 + h2) / 2 + shift, h1 + h2)

    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    product = jnp.where(colored, c1 * c2, jnp.ones_like(c1))
    delta_hue = jnp.where(colored, 2 * jnp.sqrt(product) * jnp.sin(turn / 2), jnp.zeros_like(turn))
    t = (
        1
        - 0.17 * jnp.cos(hue - np.radians(30.0).item())
        + 0.24 * jnp.cos(2 * hue)
        + 0.32 * jnp.cos(3 * hue + np.radians(6.0).item())
        - 0.20 * jnp.cos(4 * hue - np.radians(63.0).item())
    )
    offset = (lightness - 50) ** 2
    scaled_l = (l2 - l1) / (1 + 0.015 * offset / jnp.sqrt(20 + offset))
    scaled_c = (c2 - c1) / (1 + 0.045 * chroma)
    scaled_h = delta_hue / (1 + 0.015 * chroma * t)
    blue = jnp.exp(-(((jnp.rad2deg(hue) - 275) / 25) ** 2))
    rotation = -2 * _saturation(chroma) * jnp.sin(np.radians(60.0).item() * blue)
    # l² + c² + h² + R c h as a sum of squares; |R| < √3.
    turned = scaled_c + rotation / 2 * scaled_h
    return jnp.stack([scaled_l, turned, scaled_h * jnp.sqrt(1 - rotation**2 / 4)], axis=-1)


def _saturation(chroma: Float[Array, "..."]) -> Float[Array, "..."]:
    """√(C⁷ / (C⁷ + 25⁷))."""
    ratio = chroma / 25
    return ratio**3.5 / jnp.sqrt(1 + ratio**7)


def _root(squared: Float[Array, "..."]) -> Float[Array, "..."]:
    """√, with zero gradient at 0."""
    positive = squared > 0
    return jnp.where(
        positive, jnp.sqrt(jnp.where(positive, squared, jnp.ones_like(squared))), jnp.zeros_like(squared)
    )


def _length(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    return _root(a * a + b * b)


def _hue(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    """Angle from 0 to 2π, and 0 with zero gradient where there is none."""
    neutral = a * a + b * b == 0
    angle = jnp.arctan2(jnp.where(neutral, jnp.zeros_like(b), b), jnp.where(neutral, jnp.ones_like(a), a))
    return jnp.where(angle < 0, angle + 2 * jnp.pi, angle)


def _real(value: ArrayLike, dtype: jnp.dtype | None = None) -> Array:
    if dtype is None and isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
        return value
    return jnp.asarray(value, jnp.result_type(float) if dtype is None else dtype)


def _checked_wavelengths(wavelengths_nm: Wavelengths, partial: bool) -> NDArray[np.float64]:
    if isinstance(wavelengths_nm, jax.core.Tracer):
        raise ValueError("wavelengths are traced: expected known numbers; make them a constant of the function")
    wavelengths = np.asarray(wavelengths_nm, np.float64)
    if wavelengths.ndim != 1 or wavelengths.size < 2 or not np.isfinite(wavelengths).all():
        raise ValueError(
            f"wavelengths of shape {wavelengths.shape} give no color: expected two or more, in nm, "
            "equally spaced, in one axis"
        )
    steps = np.diff(wavelengths)
    step = (wavelengths[-1] - wavelengths[0]) / steps.size
    uneven = np.abs(steps - step) > _EDGE * max(abs(step), np.abs(wavelengths).max())
    if uneven.any() or step == 0:
        at = int(np.argmax(uneven))
        raise ValueError(
            f"wavelengths are not equally spaced: from {wavelengths[at]:g} to {wavelengths[at + 1]:g} nm the step "
            f"is not {step:g} nm; expected equal steps (resample the spectrum first)"
        )
    if abs(step) > _COARSEST_NM * (1 + _EDGE):
        raise ValueError(
            f"{abs(step):g} nm is too coarse a step for a color: expected at most {_COARSEST_NM:g} nm"
        )
    low, high = float(wavelengths.min()), float(wavelengths.max())
    short = low > _VISIBLE_NM[0] * (1 + _EDGE) or high < _VISIBLE_NM[1] * (1 - _EDGE)
    if short and not partial:
        raise ValueError(
            f"{low:g} to {high:g} nm do not cover {_VISIBLE_NM[0]:g} to {_VISIBLE_NM[1]:g} nm: expected the "
            "visible range, or partial=True for a color of the part that is there"
        )
    return wavelengths


def _weights(
    wavelengths: NDArray[np.float64], illuminant: str, observer: str, practice: str | None
) -> NDArray[np.float64]:
    """What to multiply a spectrum with, shape (L, 3)."""
    for name, known, what in (
        (illuminant, ILLUMINANTS, "an illuminant"),
        (observer, OBSERVERS, "an observer"),
        ("sum" if practice is None else practice, PRACTICES, "a practice"),
    ):
        if name not in known:
            raise ValueError(f"{name!r} is not {what}: expected one of {', '.join(known)}")
    step = abs(wavelengths[-1] - wavelengths[0]) / (wavelengths.size - 1)
    nearest = round(step)
    offset = np.abs(wavelengths - np.round(wavelengths / min(nearest, 10)) * min(nearest, 10)) if nearest else step
    defined = nearest in _PRACTICE_STEPS and bool(np.all(offset < _EDGE * wavelengths))
    if practice == "ASTM E308" and not defined:
        raise ValueError(
            f"ASTM E308 is not defined for {wavelengths[0]:g} to {wavelengths[-1]:g} nm in steps of {step:g} nm: "
            "expected multiples of a step of 1, 5, 10 or 20 nm, or practice='sum'"
        )
    if defined and practice != "sum":
        return _practice_weights(np.round(wavelengths), nearest, illuminant, observer)
    power, functions = _table(illuminant), _table(observer)
    low, high = (float(pick(power[end, 0], functions[end, 0])) for pick, end in ((max, 0), (min, -1)))
    outside = (wavelengths < low * (1 - _EDGE)) | (wavelengths > high * (1 + _EDGE))
    if outside.any():
        raise ValueError(
            f"wavelength {wavelengths[outside][0]:g} nm is outside the tables of {illuminant} and {observer}, "
            f"{low:g} nm to {high:g} nm: leave it out"
        )
    light = np.interp(wavelengths, power[:, 0], power[:, 1])
    matching = np.stack(
        [np.interp(wavelengths, functions[:, 0], column) for column in functions[:, 1:].T], axis=-1
    )
    weights = light[:, None] * matching
    return 100 * weights / weights[:, 1].sum()


@functools.cache
def _practice_table(step: int, illuminant: str, observer: str) -> NDArray[np.float64]:
    """Weights of all values from 360 to 780 nm in steps of 1, 5 or 10 nm, shape (N, 3)."""
    power, functions = _table(illuminant), _table(observer)
    light = np.interp(_PRACTICE_NM, power[:, 0], power[:, 1])
    matching = [np.interp(_PRACTICE_NM, functions[:, 0], column) for column in functions[:, 1:].T]
    weights = light[:, None] * np.stack(matching, axis=-1)
    weights = _interpolation(len(_PRACTICE_NM), step).T @ weights if step == 10 else weights[::step]
    weights = weights * 100 / weights[:, 1].sum()
    weights.flags.writeable = False
    return weights


def _practice_weights(
    wavelengths: NDArray[np.float64], step: int, illuminant: str, observer: str
) -> NDArray[np.float64]:
    """Weights of ASTM E308, shape (L, 3); 0 beyond 360 to 780 nm.

    References:
        [ASTME308]; [ASTME2022] for the interpolation of 10 nm data.
    """
    order = np.argsort(wavelengths)
    rising = wavelengths[order]
    inside = (rising >= _PRACTICE_NM[0]) & (rising <= _PRACTICE_NM[-1])
    known = rising[inside]
    finer = min(step, 10)
    weights = _practice_table(finer, illuminant, observer)
    # The end values stand for what was not measured.
    first, last = (int(known[end] - _PRACTICE_NM[0]) // finer for end in (0, -1))
    folded = weights[first : last + 1].copy()
    folded[0] += weights[:first].sum(axis=0)
    folded[-1] += weights[last + 1 :].sum(axis=0)
    if step == 20:
        folded = _halved(len(known)).T @ folded
    found = np.zeros((wavelengths.size, 3))
    found[order[inside]] = folded
    return found


@functools.cache
def _interpolation(count: int, step: int) -> NDArray[np.float64]:
    """From values at every so many places to all: cubic, and quadratic in the first and last interval."""
    coarse = np.arange(0, count, step)
    matrix = np.zeros((count, coarse.size))
    for place in range(count):
        interval = min(place // step, coarse.size - 2)
        first = int(np.clip(interval - 1, 0, coarse.size - 4))
        nodes = np.arange(first, first + 4)
        if interval == 0:
            nodes = nodes[:3]
        elif interval == coarse.size - 2:
            nodes = nodes[1:]
        for i in nodes:
            others = coarse[nodes[nodes != i]]
            matrix[place, i] = np.prod((place - others) / (coarse[i] - others))
    return matrix


def _halved(count: int) -> NDArray[np.float64]:
    """From values at every 20 nm to every 10 nm: cubic; beyond the ends the parabola through the last three."""
    values = np.eye(count)
    below = 3 * values[0] - 3 * values[1] + values[2]
    above = 3 * values[-1] - 3 * values[-2] + values[-3]
    padded = np.concatenate([below[None], values, above[None]])
    between = (-padded[:-3] + 9 * padded[1:-2] + 9 * padded[2:-1] - padded[3:]) / 16
    found = np.empty((2 * count - 1, count))
    found[::2], found[1::2] = values, between
    return found


@functools.cache
def _table(name: str) -> NDArray[np.float64]:
    """Wavelengths and the columns of an observer, or the power of an illuminant."""
    path = importlib.resources.files("vcavity_jax") / "data" / "cie"
    if name in OBSERVERS:
        lines = (path / f"{name.replace(' ', '-')}.csv").read_text(encoding="utf-8").splitlines()
        table = np.loadtxt(lines, delimiter=",", skiprows=1)
    else:
        lines = (path / "illuminants.csv").read_text(encoding="utf-8").splitlines()
        column = lines[0].split(",").index(name)
        rows = [line.split(",") for line in lines[1:]]
        table = np.array([[float(row[0]), float(row[column])] for row in rows if row[column]])
    table.flags.writeable = False
    return table
