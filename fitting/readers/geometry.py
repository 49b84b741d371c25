"""Where the light of a measurement comes from and where it goes to, as the metadata of its file states it.

Either `geometry` names both, or `illumination` states the light and the directions are listed. Nothing here
needs more than the standard library until a light or a view is made, so that the command line may use it.
"""

import math
import re
from dataclasses import dataclass
from typing import Any

from fitting.readers import TextTable, number, quoted, suggestion

# As in `vcavity_jax.geometries`, which a test compares; importing that takes half a second.
GEOMETRIES = ("d:0", "d:8", "di:8", "de:8", "d:d", "0:d", "8:d", "45a:0", "45x:0")
TURNED = ("d:8", "di:8", "de:8", "8:d", "45x:0")
"""Geometries with one direction off the normal: how the sample lies in the instrument matters."""

TRAPPED = ("de:8",)
"""Geometries with a gloss trap."""

WIDEST_TRAP_DEG = 16.0
"""Half-angle at which a gloss trap reaches the receiver."""

LIGHTS: dict[str, dict[str, tuple[float, float]]] = {
    "diffuse": {},
    "directional": {"polar_deg": (-90.0, 90.0), "azimuth_deg": (-360.0, 360.0)},
    "annular": {"polar_deg": (0.0, 90.0)},
}
"""The kinds of light, and the angles that each needs with their limits, degrees."""


@dataclass(frozen=True)
class Geometry:
    """The light of a measurement, and its view if that has a name.

    Args:
        illumination: a light of `vcavity_jax`; None for diffuse light, for which nothing need be imported.
        view: `vcavity_jax.Hemisphere`, or a `vcavity_jax.View` of one direction; None if the file lists the
            directions.
    """

    illumination: Any
    view: Any = None

    @property
    def hemispherical(self) -> bool:
        """All reflected light is collected."""
        return self.view is not None and not hasattr(self.view, "polar")


def named(name: str, azimuth_deg: float = 0.0, trap_half_angle_deg: float | None = None) -> Geometry:
    """The geometry of a name in `GEOMETRIES`.

    Args:
        name: illumination:view, as `vcavity_jax.cie_geometry` takes it.
        azimuth_deg: of the direction that is not the normal, degrees; 0 across the grooves, 90 along them.
        trap_half_angle_deg: of the gloss trap of "de:8", degrees; None for the usual one.

    Raises:
        ValueError: the name is unknown or an angle lies outside its range.
    """
    # JAX takes half a second to import: who reads a file in diffuse light does not pay for it here.
    import vcavity_jax

    chosen: Any = name
    azimuth = math.radians(azimuth_deg)
    if trap_half_angle_deg is None:
        return Geometry(*vcavity_jax.cie_geometry(chosen, azimuth))
    trap = math.radians(trap_half_angle_deg)
    return Geometry(*vcavity_jax.cie_geometry(chosen, azimuth, trap_half_angle=trap))


def light(kind: str, *angles_deg: float) -> Any:
    """A light of `vcavity_jax` from its kind and angles in degrees; None for diffuse light."""
    if kind == "diffuse":
        return None
    import vcavity_jax

    make = {"directional": vcavity_jax.Directional, "annular": vcavity_jax.Annular}[kind]
    return make(*map(math.radians, angles_deg))


def of_table(table: TextTable) -> Geometry:
    """What the metadata of a file say of light and view.

    Args:
        table: the file, taken apart.

    Raises:
        ValueError: they contradict each other or the columns, or are not understood; the message names file
            and line.
    """
    entry = table.entries.get("geometry")
    if entry is None:
        for key in ("geometry_azimuth_deg", "trap_half_angle_deg"):
            if key in table.entries:
                raise table.error(
                    table.entries[key].line, f"{key} without a geometry; expected '# geometry: de:8', say, with it"
                )
        return Geometry(_illumination(table))
    name = entry.value.lower().replace("°", "").replace(" ", "")
    if name not in GEOMETRIES:
        close = suggestion(name.replace("/", ":"), GEOMETRIES)
        raise table.error(
            entry.line,
            f"geometry {quoted(entry.value)} is unknown{close}; expected one of {', '.join(GEOMETRIES)}",
        )
    _refuse_directions(table, name, entry.line)
    azimuth = _angle(table, "geometry_azimuth_deg", name, TURNED)
    trap = _angle(table, "trap_half_angle_deg", name, TRAPPED)
    return named(name, 0.0 if azimuth is None else azimuth, trap)


def _refuse_directions(table: TextTable, name: str, line: int) -> None:
    """A geometry is the only source of light and view."""
    if "illumination" in table.entries:
        raise table.error(
            table.entries["illumination"].line,
            f"illumination beside geometry {name} in line {line}; expected one of them",
        )
    turned = ": for the azimuth write '# geometry_azimuth_deg: 90'" if name in TURNED else ""
    for key in ("polar_deg", "azimuth_deg"):
        found: list[tuple[int, str]] = []
        if key in table.entries:
            found.append((table.entries[key].line, key))
        if table.header is not None and key in table.header:
            found.append((table.header_line, f"column {key!r}"))
        for where, what in found:
            raise table.error(
                where,
                f"{what} beside geometry {name} in line {line}, which sets the view; expected one of them{turned}",
            )


def _angle(table: TextTable, key: str, name: str, having: tuple[str, ...]) -> float | None:
    """An angle of a geometry in degrees, None if it is not given."""
    entry = table.entries.get(key)
    if entry is None:
        return None
    if name not in having:
        raise table.error(entry.line, f"{key} has no effect in {name}; expected it with {', '.join(having)} only")
    value = number(entry.value)
    if key == "trap_half_angle_deg":
        good = value is not None and 0 <= value < WIDEST_TRAP_DEG
        expected = f"0 to less than {WIDEST_TRAP_DEG:g} degrees, where the trap covers the receiver"
    else:
        good, expected = value is not None and abs(value) <= 360, "-360 to 360 degrees"
    if not good:
        raise table.error(entry.line, f"{key} is {quoted(entry.value)}; expected {expected}")
    return value


def _illumination(table: TextTable) -> Any:
    """The light that `illumination` states; None, for diffuse light, if it states none."""
    entry = table.entries.get("illumination")
    if entry is None:
        return None
    try:
        return light_of(entry.value)
    except ValueError as error:
        raise table.error(entry.line, str(error)) from None


def light_of(text: str) -> Any:
    """The light that words describe, such as "directional, polar_deg=45, azimuth_deg=0"; None for diffuse light.

    Raises:
        ValueError: they are not understood.
    """
    kind, *parts = (part.strip() for part in text.lower().split(","))
    limits = LIGHTS.get(kind)
    found = {key.strip(): number(value) for key, _, value in (part.partition("=") for part in parts)}
    good = limits is not None and len(parts) == len(limits) and set(found) == set(limits)
    angles = []
    if limits is not None and good:
        for key, (low, high) in limits.items():
            value = found[key]
            # A NaN angle fails the comparison and is refused with the angles out of range.
            if value is None or not low <= value <= high:
                good = False
                break
            angles.append(value)
    if not good:
        raise ValueError(
            f"illumination is {quoted(text)}; expected 'diffuse', 'directional, polar_deg=45, "
            "azimuth_deg=0' (polar within 90, azimuth within 360 degrees) or 'annular, polar_deg=45'"
        )
    return light(kind, *angles)


def understood(text: str, specular: str = "", configuration: str = "") -> tuple[str, ...]:
    """The names in `GEOMETRIES` that agree with an instrument's words; none if they are strange to us.

    Light and receiver may stand in either order: the factor is the same, by reciprocity.

    Args:
        text: such as "45/0", "d:8", "D/8 SCI", "45°a:0°".
        specular: "included" or "excluded", where the file says it elsewhere.
        configuration: "annular" or "uniplanar", likewise.
    """
    words = text.lower().replace("°", "").replace("deg", "").replace("*", "")
    if re.search(r"sci|specular.?included|spin", words):
        specular = "included"
    if re.search(r"sce|specular.?excluded|spex", words):
        specular = "excluded"
    configuration = "annular" if re.search(r"annular|circ", words) else configuration
    match = re.match(r"\W*(di|de|d|\d+[acx]?)\s*[:/,x-]\s*(di|de|d|\d+[acx]?)(?![\d.])", words)
    if match is None:
        return ()
    ends = {match[1], match[2]}
    for name, other in (("di", "included"), ("de", "excluded")):
        if name in ends:
            specular, ends = other, (ends - {name}) | {"d"}
    if ends == {"d", "8"}:
        ways = {"included": ("di:8",), "excluded": ("de:8",)}
        return ways.get(specular, ("8:d",) if match[1] == "8" else ("di:8", "de:8", "d:8"))
    if ends == {"d", "0"}:
        return ("0:d",) if match[1] == "0" else ("d:0",)
    if ends == {"d"}:
        return ("d:d",)
    if "0" in ends and len(ends) == 2:
        angle = (ends - {"0"}).pop()
        kind = {"45a": "annular", "45c": "annular", "45x": "uniplanar"}.get(angle, configuration)
        if angle in ("45", "45a", "45c", "45x"):
            return {"annular": ("45a:0",), "uniplanar": ("45x:0",)}.get(kind, ("45a:0", "45x:0"))
    return ()
