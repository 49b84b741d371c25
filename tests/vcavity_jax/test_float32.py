"""Single precision: 1e-5 from 20 degrees on, in a process of its own, as a user of plain JAX runs it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

DATA = Path(__file__).parents[1] / "data"

PROGRAM = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
import vcavity_jax as vc

assert not jax.config.read("jax_enable_x64")
data = sys.argv[1]
MODELS = {"exact": "full", "unpol": "unpolarized", "sep": "separate"}
worst = {}

def note(name, value, truth):
    assert value.dtype == np.float32, value.dtype
    worst[name] = max(worst.get(name, 0.0), float(np.max(np.abs(np.asarray(value, float) - truth))))

def column(records, key):
    return jnp.asarray([float(r[key]) for r in records])

def angles(records):
    return tuple(jnp.radians(column(records, k)) for k in ("alpha_deg", "theta_deg", "phi_deg"))

mirrors = json.load(open(data + "/specular.json"))
for name, model in MODELS.items():
    records = [r for r in mirrors["hdr"] if r["model"] == name and r["alpha_deg"] >= 20]
    def one(angle, polar, azimuth, n, k):
        material = vc.Specular(jax.lax.complex(n, k), model)
        scene = vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), vc.View(polar, azimuth))
        return vc.reflectance_factor(scene)
    value = jax.jit(jax.vmap(one))(*angles(records), column(records, "n"), column(records, "k"))
    note("mirrors " + model, value, np.array([r["hdr"] for r in records]))

def direction(name):
    return [0.0, 0.0] if name == "frontal" else np.radians(name).tolist()

diffusers = json.load(open(data + "/lambertian.json"))
for diffuse in (True, False):
    records = [r for r in diffusers["data"] if (r["light"] == "diffuse") == diffuse and r["alpha_deg"] >= 20]
    view = jnp.asarray([direction(r["view"]) for r in records])
    light = view if diffuse else jnp.asarray([direction(r["light"]) for r in records])
    def one(angle, reflectance, light, view):
        source = vc.Diffuse() if diffuse else vc.Directional(light[0], light[1])
        scene = vc.Scene(vc.VGrooves(angle), vc.Lambertian(reflectance), source, vc.View(view[0], view[1]))
        return vc.reflectance_factor(scene, 1e-5)
    # Batches keep the memory of the mapped contours small.
    value = jax.jit(lambda *c: jax.lax.map(lambda a: one(*a), c, batch_size=32))(
        jnp.radians(column(records, "alpha_deg")), column(records, "r"), light, view
    )
    note("diffusers, " + ("diffuse" if diffuse else "parallel"), value,
         np.array([r["mean_radiance_factor"] for r in records]))

for degrees in (20.0, 45.0, 90.0):
    records = [r for r in diffusers["data"] if r["light"] == "frontal" and r["view"] == "frontal"
               and r["alpha_deg"] == degrees]
    scene = vc.Scene(vc.VGrooves(np.radians(degrees)), vc.Lambertian(np.array([r["r"] for r in records])),
                     vc.Directional(), vc.View())
    note("open, planned", vc.reflectance_factor(scene, 1e-5),
         np.array([r["mean_radiance_factor"] for r in records]))

def gradient(angle):
    scene = vc.Scene(vc.VGrooves(angle), vc.Specular(0.35 + 2.7j), vc.Diffuse(), vc.View(0.3, 0.4))
    return vc.reflectance_factor(scene)
assert np.isfinite(jax.grad(gradient)(jnp.asarray(0.7)))
print(json.dumps(worst))
"""


@pytest.fixture(scope="module")
def worst() -> dict[str, float]:
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROGRAM, str(DATA)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr[-3000:]
    found: dict[str, float] = json.loads(run.stdout)
    return found


KINDS = (
    *("mirrors full", "mirrors unpolarized", "mirrors separate"),
    *("diffusers, diffuse", "diffusers, parallel", "open, planned"),
)


@pytest.mark.parametrize("kind", KINDS)
def test_records(kind: str, worst: dict[str, float]) -> None:
    """1e-5 absolute, of values up to 3.7: some hundred roundings of 6e-8."""
    assert worst[kind] < 1e-5
    assert np.isfinite(worst[kind])
    assert worst[kind] > 1e-9  # it was single precision, indeed
