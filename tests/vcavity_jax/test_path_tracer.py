"""Mirrors and diffusers against an independent path tracer: no formula in common with the library."""

import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vcavity_jax as vc

TRUTH: list[dict[str, Any]] = json.loads((Path(__file__).parents[1] / "data" / "path-tracer.json").read_text())[
    "records"
]


def radians(records: list[dict[str, Any]]) -> tuple[jax.Array, ...]:
    return tuple(
        jnp.radians(jnp.asarray([float(r[k]) for r in records])) for k in ("alpha_deg", "theta_deg", "phi_deg")
    )


def assert_within_noise(value: jax.Array, records: list[dict[str, Any]]) -> None:
    """Five standard errors, and 4e-4 for the path tracer's own ray offset at small angles (its README)."""
    mean, error = (np.array([r[key] for r in records]) for key in ("mean", "stderr"))
    excess = np.abs(np.asarray(value) - mean) - (5 * error + 4e-4)
    assert np.max(excess) < 0, records[int(np.argmax(excess))]


@pytest.mark.parametrize(("polarised", "model"), [(True, "full"), (False, "unpolarized")])
def test_conductors(polarised: bool, model: Any) -> None:
    records = [r for r in TRUTH if r["type"] == "conductor" and r["polarised"] == polarised]
    assert len(records) > 30
    index = jnp.asarray([r["eta"] + 1j * r["k"] for r in records])

    @jax.jit
    @jax.vmap
    def one(angle: Any, polar: Any, azimuth: Any, index: Any) -> Any:
        return vc.reflectance_factor(
            vc.Scene(vc.VGrooves(angle), vc.Specular(index, model), vc.Diffuse(), vc.View(polar, azimuth))
        )

    assert_within_noise(one(*radians(records), index), records)


def test_the_tracer_tells_polarization_apart() -> None:
    """The two sets of conductors differ by more than the noise, so that the test above can fail."""
    records = [r for r in TRUTH if r["type"] == "conductor" and r["polarised"]]

    @jax.jit
    @jax.vmap
    def unpolarized(angle: Any, polar: Any, azimuth: Any, index: Any) -> Any:
        material = vc.Specular(index, "unpolarized")
        return vc.reflectance_factor(vc.Scene(vc.VGrooves(angle), material, vc.Diffuse(), vc.View(polar, azimuth)))

    index = jnp.asarray([r["eta"] + 1j * r["k"] for r in records])
    with pytest.raises(AssertionError):
        assert_within_noise(unpolarized(*radians(records), index), records)


def test_diffusers() -> None:
    records = [r for r in TRUTH if r["type"] == "diffuse"]
    assert len(records) > 30
    reflectance = jnp.asarray([r["r"] for r in records])

    @jax.jit
    @jax.vmap
    def one(angle: Any, polar: Any, azimuth: Any, reflectance: Any) -> Any:
        return vc.reflectance_factor(
            vc.Scene(vc.VGrooves(angle), vc.Lambertian(reflectance), vc.Diffuse(), vc.View(polar, azimuth)),
            1e-6,
        )

    assert_within_noise(one(*radians(records), reflectance), records)
