"""Tables 2, 3 and 4 of the thesis, computed to convergence: thesis value, converged value, difference.

    python examples/thesis_tables.py [OUTDIR]

prints the tables and writes them to OUTDIR/thesis_tables.md (a new temporary folder by default). The thesis
sampled the hemisphere and the panels; docs/errata.md says why its values differ. It does not give its optical
constants, so the tables of this project that come closest are used, and named.
"""

import argparse
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import vcavity_jax as vc
from vcavity_jax import bihemispherical, colorimetry, resolution

jax.config.update("jax_enable_x64", True)

TOLERANCE = 1e-10
ANGLES_DEG = (45, 60, 90, 120, 150, 180)
WAVELENGTHS_NM = np.arange(380.0, 731.0, 10.0)
SILVER = 0.1249 + 3.3391j  # What reproduces the thesis's silver at 550 nm; no published table does.

TABLE_2 = {
    "black glass": ("1.5", (0.9, 1.6, 3.5, 5.5, 7.3, 8.6)),
    "silicon": ("Si-Green-2008", (11.0, 16.6, 26.4, 34.0, 36.8, 37.3)),
    "gold": ("Au-McPeak", (66.3, 72.9, 80.0, 83.6, 85.1, 85.4)),
    "silver": (f"{SILVER.real}+{SILVER.imag}j", (89.7, 92.1, 94.4, 95.6, 96.0, 96.1)),
    "copper": ("Cu-Johnson", (33.9, 42.8, 54.4, 61.2, 63.9, 64.6)),
    "aluminum": ("Al-Rakic", (77.1, 82.2, 87.4, 90.2, 91.0, 90.9)),
}
"""Bi-hemispherical reflectance at 550 nm in percent, by dihedral angle."""

TABLE_3 = {
    ("black glass", "unpolarized"): ("1.5", (0.09, 0.42, 0.27, 0.15, 0.09, 0.0)),
    ("gold", "unpolarized"): ("Au-McPeak", (0.09, 0.25, 0.20, 0.12, 0.07, 0.0)),
    ("copper", "unpolarized"): ("Cu-Johnson", (0.10, 0.10, 0.04, 0.45, 0.34, 0.0)),
    ("silicon", "unpolarized"): ("Si-Green-2008", (0.61, 1.13, 1.00, 0.27, 0.25, 0.0)),
    ("silicon", "separate"): ("Si-Green-2008", (4.96, 4.57, 2.47, 0.50, 0.04, 0.0)),
}
"""Color difference ΔE 2000 of the approximate models of polarization, by dihedral angle."""

TABLE_4 = {45: (13.4, 39.0, 71.3, 89.7), 60: (24.3, 66.7, 92.1), 90: (54.7, 94.4)}
"""Bi-hemispherical reflectance of silver in percent, with rays of at most N reflections only, by N."""


def index(name: str, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Refractive index: a number or a table of the project."""
    if name[0].isdigit():
        return np.full(wavelengths_nm.shape, complex(name))
    return vc.materials.refractive_index(name, wavelengths_nm)


def reflectance(optical: np.ndarray, model: str = "full") -> Array:
    """Bi-hemispherical reflectance at the angles of the tables, shape (angles, wavelengths)."""

    def at(angle: Array) -> Array:
        material = vc.Specular(optical, model)
        return vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), material, *vc.cie_geometry("d:d")), TOLERANCE)

    return jax.jit(lambda angles: jax.lax.map(at, angles))(jnp.deg2rad(jnp.asarray(ANGLES_DEG, float)))


def lab(optical: np.ndarray, model: str) -> Array:
    """L*a*b* under D65 for the 2° observer, relative to the perfect diffuser, shape (angles, 3)."""
    white = colorimetry.white(WAVELENGTHS_NM)
    return colorimetry.lab(colorimetry.xyz(reflectance(optical, model), WAVELENGTHS_NM), white)


def by_reflections(angle_deg: float, most: int) -> np.ndarray:
    """Share of the reflectance of silver by rays of at most 1 ... most reflections."""
    angle = jnp.deg2rad(jnp.asarray(angle_deg, float))
    nodes = resolution.bihemispherical_orders(TOLERANCE, float(angle), tame=True)
    return np.cumsum(bihemispherical.by_reflections(angle, jnp.asarray(SILVER), most, "full", nodes))


def table(title: str, heads: list[str], rows: list[tuple[str, tuple[float, ...], np.ndarray]], digits: int) -> str:
    """A Markdown table; each cell reads thesis → converged (difference)."""
    lines = [f"**{title}**", "", "| | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for name, thesis, converged in rows:
        cells = [
            f"{old:g} → {new:.{digits}f} ({new - old:+.{digits}f})"
            for old, new in zip(thesis, converged, strict=True)
        ]
        cells += [""] * (len(heads) - len(cells))
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write")
    outdir = parser.parse_args().outdir or Path(tempfile.mkdtemp(prefix="thesis-tables-"))
    green = np.array([550.0])
    second = [
        (f"{name} ({source})", thesis, 100 * np.asarray(reflectance(index(source, green)))[:, 0])
        for name, (source, thesis) in TABLE_2.items()
    ]
    third = []
    for (name, model), (source, thesis) in TABLE_3.items():
        optical = index(source, WAVELENGTHS_NM)
        difference = colorimetry.delta_e_2000(lab(optical, "full"), lab(optical, model))
        third.append((f"{name} ({source}), {model}", thesis, np.asarray(difference)))
    fourth = [(f"{angle}°", thesis, 100 * by_reflections(angle, len(thesis))) for angle, thesis in TABLE_4.items()]
    angles, reflections = [f"{angle}°" for angle in ANGLES_DEG], [f"N = {n}" for n in range(1, 5)]
    text = "\n".join(
        [
            table("Table 2, bi-hemispherical reflectance at 550 nm in %: thesis → converged", angles, second, 2),
            table("Table 3, ΔE 2000 of approximate polarization: thesis → converged", angles, third, 3),
            table("Table 4, silver, rays of at most N reflections, in %", reflections, fourth, 2),
        ]
    )
    outdir.mkdir(parents=True, exist_ok=True)
    (outdir / "thesis_tables.md").write_text(text, encoding="utf-8")
    print(text)
    print(f"wrote {outdir / 'thesis_tables.md'}")


if __name__ == "__main__":
    main()
