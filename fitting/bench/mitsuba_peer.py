"""Mitsuba 3 as a peer, where it is installed: one groove as a mesh, seen frontally in diffuse light.

It is asked for by name (``vcavity bench --peer mitsuba``) and no dependency: pip install mitsuba. The environment
variable MITSUBA_VARIANT chooses another variant than scalar_rgb, say llvm_ad_rgb.
"""

import dataclasses
import os
from typing import Any

import numpy as np

from fitting.bench.diffusing import REFLECTANCES
from fitting.bench.measure import Peer, Quantity, Real

_SAMPLES, _PIXELS = 64, 16


def beside(quantity: Quantity) -> Quantity:
    """The quantity with this peer, if it can be rendered so.

    Raises:
        ValueError: it is not installed.
    """
    try:
        import mitsuba  # noqa: F401
    except ImportError:
        raise ValueError(
            "--peer mitsuba: not installed; expected the package mitsuba (pip install mitsuba)"
        ) from None
    if (quantity.part, quantity.name) != ("diffusing", "diffuse light, frontal view"):
        return quantity
    peer = Peer(f"Mitsuba 3, {_SAMPLES * _PIXELS**2} paths per wavelength", _rendered, random=True)
    return dataclasses.replace(quantity, peers=(*quantity.peers, peer))


def _rendered(angle: float) -> Real:
    """Three wavelengths at a time stand for red, green and blue."""
    import mitsuba as mi

    # The compiled variants need an LLVM of their own, and end the process where it is too old.
    mi.set_variant(os.environ.get("MITSUBA_VARIANT", "scalar_rgb"))
    s, c = float(np.sin(angle / 2)), float(np.cos(angle / 2))
    looking = mi.ScalarTransform4f().look_at(origin=[0, 0, 10], target=[0, 0, 0], up=[1, 0, 0])
    film = {
        "type": "hdrfilm",
        "width": _PIXELS,
        "height": _PIXELS,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
    }
    found = []
    for triple in REFLECTANCES.reshape(-1, 3):
        shade = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(r) for r in triple]}}
        panels = {f"panel {side}": _panel(mi, side * s, c, shade) for side in (-1, 1)}
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": -1, "rr_depth": 1000},
                "light": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
                "sensor": {
                    "type": "orthographic",
                    "to_world": looking @ mi.ScalarTransform4f().scale([s, s, 1]),
                    "film": film,
                    "sampler": {"type": "independent", "sample_count": _SAMPLES},
                },
                **panels,
            }
        )
        found.append(np.asarray(mi.render(scene, spp=_SAMPLES)).reshape(-1, 3).mean(axis=0))
    return np.concatenate(found).astype(np.float64)


def _panel(mi: Any, across: float, up: float, shade: dict[str, Any]) -> Any:
    """A unit panel from the fold (the line y = z = 0) to its rim, long along x; Mitsuba's own rectangles leak."""
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict({"type": "twosided", "nested": shade})
    mesh = mi.Mesh("panel", 4, 2, props=properties)
    parameters = mi.traverse(mesh)
    corners = [(-20, 0, 0), (20, 0, 0), (20, across, up), (-20, across, up)]
    parameters["vertex_positions"] = np.ravel(corners).astype(np.float32)
    parameters["faces"] = np.array([0, 1, 2, 0, 2, 3], np.uint32)
    parameters.update()
    return mesh
