"""The tables `[parameters.NAME]` of a config file: what is free, and for which measurements."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fitting import free
from fitting.cli import keys, words
from fitting.cli.keys import Check, Place
from fitting.readers import suggestion

_LIMITS: dict[str, Check] = {"lower": keys.number, "upper": keys.number}
_NUMBER: dict[str, Check] = {**_LIMITS, "prior": keys.prior}
_FRACTION: dict[str, Check] = {
    **_LIMITS,
    "smooth_nm": keys.of_word(words.length),
    "prior": keys.relative_prior,
}
KEYS: dict[str, dict[str, Check]] = {
    "angle": {"lower_deg": keys.number, "upper_deg": keys.number, "prior": keys.prior},
    "roughness": _NUMBER,
    "reflectance": _FRACTION,
    "transmittance": _FRACTION,
    "coverage": _NUMBER,
    "gain": {"prior": keys.prior},
    "offset": {"prior": keys.prior},
    "tilt": {"limit_deg": keys.number, "prior": keys.prior},
    "stray_light": {"upper": keys.number, "prior": keys.prior},
    "wavelength_shift": {"limit_nm": keys.number, "prior": keys.prior},
}
"""What each parameter but the index may be told."""

_OSCILLATOR = "[strength, energy_ev, width_ev]"


def _oscillator(value: Any, place: Place) -> tuple[Any, ...]:
    """The three coefficients of a resonance."""
    three = keys.many(keys.coefficient, _OSCILLATOR)(value, place)
    if len(three) != 3:
        raise place.error(f"{len(three)} coefficients; expected {_OSCILLATOR}")
    return three


_per_term = keys.many(keys.coefficient, "one number or [low, high] per term")
FORMS: dict[str, dict[str, Check]] = {
    "constant": _NUMBER,
    "per-wavelength": {"lower": keys.one, "upper": keys.one, "prior": keys.relative_prior},
    "n-and-k": {"lower": keys.two, "upper": keys.two, "prior": keys.relative_prior},
    "cauchy": dict.fromkeys(("a", "b_um2", "c_um4"), keys.coefficient),
    "sellmeier": {"b": _per_term, "c_um2": _per_term},
    "drude-lorentz": {
        **dict.fromkeys(("epsilon_infinity", "plasma_ev", "damping_ev"), keys.coefficient),
        "oscillators": keys.many(_oscillator, f"a list of {_OSCILLATOR}"),
    },
}
"""What each form of the index may be told."""

_FORMULAS: dict[str, Callable[..., Any]] = {
    "cauchy": free.Cauchy,
    "sellmeier": free.Sellmeier,
    "drude-lorentz": free.DrudeLorentz,
}


@dataclass(frozen=True)
class Freed:
    """One table: what it frees.

    Args:
        name: of the parameter, as in `words.PARAMETERS`.
        place: of the table.
        made: what `fitting.free` makes of it.
        labels: the measurements that it concerns.
        index_kind: of a free index, see `scenes.Sample`.
        around: it has a prior around the scene's own spectrum.
    """

    name: str
    place: Place
    made: list[Any]
    labels: tuple[str, ...]
    index_kind: Any = None
    around: bool = False


def read(
    content: Any, place: Place, labels: Sequence[str], defaults: Mapping[str, Mapping[str, Any]]
) -> list[Freed]:
    """The free parameters that the tables name.

    Args:
        content: what stands at `[parameters]`.
        place: where that is.
        labels: of the measurements.
        defaults: arguments of `fitting.free` where a table is silent, by the parameter's name.

    Raises:
        ValueError: a key is unknown or has a bad value.
    """

    def take(name: str) -> Check:
        def check(value: Any, where: Place) -> list[Freed]:
            several = isinstance(value, list) and len(value) > 0
            tables = [(v, where.at(i)) for i, v in enumerate(value)] if several else [(value, where)]
            return [_freed(name, v, at, labels, defaults.get(name, {})) for v, at in tables]

        return check

    found = keys.table(content, place, {name: take(name) for name in words.PARAMETERS})
    return [one for each in found.values() for one in each]


def _freed(name: str, content: Any, place: Place, labels: Sequence[str], defaults: Mapping[str, Any]) -> Freed:
    among: dict[str, Check] = {"measurements": lambda value, where: _among(value, where, labels)}
    kind = None
    if name == "index":
        form, given = _index_table(content, place, among)
        kind = {"constant": "constant", "n-and-k": "complex", "drude-lorentz": "complex"}.get(form, "real")
    else:
        form, given = "", keys.table(content, place, KEYS[name] | among)
    spread = given.pop("measurements", "shared")
    around = isinstance(given.get("prior"), float)
    if "prior" in given and name in words.PRIOR_KEY:
        given[words.PRIOR_KEY[name]] = given.pop("prior")
    try:
        made = _index(form, given) if name == "index" else getattr(free, name)(**{**defaults, **given})
    except ValueError as error:
        raise place.error(str(error)) from None
    made = list(made) if isinstance(made, tuple) else [made]
    if spread != "shared" and len(labels) > 1:
        made = [p.separate() if spread == "separate" else p.only(*spread) for p in made]
    concerned = tuple(labels) if isinstance(spread, str) else spread
    return Freed(name, place, made, concerned, kind, around)


def _index_table(content: Any, place: Place, among: dict[str, Check]) -> tuple[str, dict[str, Any]]:
    """The form of a free index and what is said of it."""
    form = "constant"
    if isinstance(content, dict) and "form" in content:
        form = keys.choice(*FORMS)(content["form"], place.at("form"))
    given = keys.table(content, place, {"form": keys.text} | FORMS[form] | among, f" of the form {form}")
    given.pop("form", None)
    return form, given


def _index(form: str, given: dict[str, Any]) -> Any:
    if form == "constant":
        return free.index(**given)
    if form in _FORMULAS:
        if form == "sellmeier" and len(given) < 2:
            raise ValueError("b or c_um2 is missing; expected both, one number or [low, high] per term")
        return free.index_spectrum(_FORMULAS[form](**given))
    return free.index_spectrum(complex_valued=form == "n-and-k", **given)


def _among(value: Any, place: Place, labels: Sequence[str]) -> Any:
    """The measurements that a parameter is for."""
    if isinstance(value, str):
        return keys.choice("shared", "separate")(value, place)
    named = keys.many(keys.text, '"shared", "separate" or a list of names of measurements')(value, place)
    for i, name in enumerate(named):
        if name not in labels:
            close = suggestion(name, labels)
            raise place.at(i).error(
                f"no measurement is named {name!r}{close}; expected some of: {', '.join(labels)}"
            )
        if name in named[:i]:
            raise place.at(i).error(f"{name!r} is given twice; expected each name once")
    return named
