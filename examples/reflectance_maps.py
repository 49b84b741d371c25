"""Maps of grooved gold, as in figure PF4-1 of the thesis: number of reflections and color, for several angles.

    python examples/reflectance_maps.py [OUTDIR] [--index TABLE] [--size PIXELS]

writes reflectance_maps.png into OUTDIR (a new temporary folder by default). The first row shows the most
reflections between which light enters and leaves the groove in each direction of view, the second its color under
D65. Lines across which the color changes its slope are those across which the number of reflections changes.
"""

import argparse
import tempfile
from pathlib import Path

import jax
import numpy as np

import vcavity_jax as vc
from fitting.map_plot import plot_maps

jax.config.update("jax_enable_x64", True)

ANGLES_DEG = (45, 60, 90, 120)
WAVELENGTHS_NM = np.arange(380.0, 731.0, 10.0)


def main() -> None:
    """Compute the maps and draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outdir", nargs="?", type=Path, help="where to write")
    parser.add_argument("--index", default="Au-Johnson", help="a table's name, see `vcavity materials`")
    parser.add_argument("--size", type=int, default=200, help="pixels along the edge of a map")
    given = parser.parse_args()
    outdir = given.outdir or Path(tempfile.mkdtemp(prefix="reflectance-maps-"))
    outdir.mkdir(parents=True, exist_ok=True)
    index = vc.materials.refractive_index(given.index, WAVELENGTHS_NM)
    maps = [
        vc.reflectance_map(
            vc.Scene(vc.VGrooves(np.deg2rad(angle)), vc.Specular(index), vc.Diffuse(), vc.View()), given.size
        )
        for angle in ANGLES_DEG
    ]
    titles = [f"{given.index}, α = {angle}°" for angle in ANGLES_DEG]  # noqa: RUF001
    plot_maps(maps, WAVELENGTHS_NM, outdir / "reflectance_maps.png", titles=titles)
    print(f"wrote {outdir / 'reflectance_maps.png'}")


if __name__ == "__main__":
    main()
