"""How panels, light and view of a diffusing groove are put together: means and local radiances.

Two panels of reflectances r₁ and r₂ separate into two problems of one panel, κ = ±ρ with ρ = √(r₁ r₂). A
light or a view that meets only one panel is a step on that panel; one that meets both is uniform on each, in
the shares of the aperture that they fill [docs/lambertian.md].
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from vcavity_jax import lambertian, wiener_hopf
from vcavity_jax.directions import components, hidden_depth, panel_share
from vcavity_jax.planning import Plan
from vcavity_jax.scene import Diffuse, Directional, Mixed

Step = tuple[Float[Array, "..."], Float[Array, "..."]]


@dataclasses.dataclass(frozen=True)
class Parities:
    """The two panels' radiosity as problems of one panel: κ = ρ and, unless the panels see alike, κ = -ρ."""

    first: Float[Array, " wavelengths"]
    second: Float[Array, " wavelengths"]
    alike: bool
    one_parity: bool
    darkest: float

    @property
    def coupling(self) -> Float[Array, " wavelengths"]:
        """ρ = √(r₁ r₂). A black panel is lifted by what the tolerance allows: √ has no gradient at 0."""
        if self.alike:
            return self.first
        product = self.first * self.second
        return jnp.sqrt(jnp.where(product < 1e-3, product + self.darkest, product))

    @property
    def kappa(self) -> Float[Array, " kappa"]:
        """The problems of one panel to solve: κ = ρ, then κ = -ρ if it is needed."""
        return self.coupling if self.one_parity else jnp.concatenate([self.coupling, -self.coupling])

    def split(self, value: Float[Array, "... kappa"]) -> tuple[Array, Array]:
        """Even and odd part of a function of κ: what stays on a panel, and what has changed sides."""
        plus, minus = jnp.split(value, 2, axis=-1)
        return (plus + minus) / 2, (plus - minus) / 2

    def diffusely_lit(self, even: Array, odd: Array) -> tuple[Array, Array]:
        """Radiance of the two panels in diffuse light, from the response to uniform light."""
        exchange = odd / self.coupling
        return (
            1 - (1 - self.first) * even - self.first * (1 - self.second) * exchange,
            1 - (1 - self.second) * even - self.second * (1 - self.first) * exchange,
        )


def _step(angle: Array, across: Array, normal: Array) -> Step:
    depth, visible = hidden_depth(angle, across, normal)
    return wiener_hopf.log_distance(depth, visible), visible


def diffuse(
    angle: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    directions: tuple[Array, Array, Array],
    plan: Plan,
    fully_seen: bool,
) -> Float[Array, "d w"]:
    """Diffuse light: HDR = 1 - (1 - r) T̃, where T̃ is the mean response over what a view sees."""
    _, across, normal = directions
    parities = Parities(*reflectances, alike, one_parity=alike, darkest=plan.darkest)
    if fully_seen:
        mean = lambertian.mean_response(angle, parities.kappa, plan.mean)
        means = jnp.broadcast_to(mean, (across.shape[0], mean.shape[0]))
    else:
        factors = lambertian.factorize(angle, parities.kappa, plan.step)
        mean_of = partial(wiener_hopf.step_mean, factors, resolution=plan.step)
        means = jax.vmap(mean_of)(*_step(angle, across, normal))
    if alike:
        return 1 - (1 - parities.first) * means
    share = panel_share(angle, across, normal)[:, None]
    first, second = parities.diffusely_lit(*parities.split(means))
    return share * first + (1 - share) * second


def directional(
    angle: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    light: Directional,
    directions: tuple[Array, Array, Array],
    plan: Plan,
) -> Float[Array, "d w"]:
    """Parallel light: the resolvent between the lit step and the seen step, for both parities."""
    _, across, normal = directions
    _, light_across, light_normal = components(light.polar, light.azimuth)
    seen = panel_share(angle, across, normal)[:, None]
    lit = panel_share(angle, light_across, light_normal)
    parities = Parities(*reflectances, alike, one_parity=alike and plan.balanced, darkest=plan.darkest)
    if plan.open:
        mean = lambertian.mean_response(angle, parities.kappa, plan.mean)
        means = jnp.broadcast_to(mean, (across.shape[0], mean.shape[0]))
    else:
        factors = lambertian.factorize(angle, parities.kappa, plan.step)
        lit_step = _step(angle, light_across, light_normal)
        field = wiener_hopf.edge_field(factors, *lit_step, plan.step)
        pair = partial(wiener_hopf.step_step, factors, field, lit_step, resolution=plan.step)
        means = jax.vmap(pair)(_step(angle, across, normal))
    first, second = reflectances
    scale = 2 * jnp.sin(angle / 2)
    if parities.one_parity:
        return scale * first * means / 2
    even, odd = parities.split(means)
    same = seen * lit * first + (1 - seen) * (1 - lit) * second
    other = seen * (1 - lit) + (1 - seen) * lit
    return scale * (same * even + other * parities.coupling * odd)


def local_radiance(
    light: Diffuse | Directional | Mixed,
    angle: Array,
    reflectances: tuple[Array, Array],
    position: Array,
    plan: Plan,
) -> Float[Array, "2 p w"]:
    """Radiance of both panels at positions from 0 (fold) to 1 (rim)."""
    if isinstance(light, Mixed):
        diffuse = local_radiance(Diffuse(), angle, reflectances, position, plan)
        directional = local_radiance(light.directional, angle, reflectances, position, plan)
        return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
    first, second = reflectances
    parities = Parities(first, second, alike=False, one_parity=False, darkest=plan.darkest)
    factors = lambertian.factorize(angle, parities.kappa, plan.step)
    step = jnp.full((), wiener_hopf.FULL, position.dtype), jnp.ones((), position.dtype)
    lit = jnp.full((), 0.5, position.dtype)
    if isinstance(light, Directional):
        _, across, normal = components(light.polar, light.azimuth)
        step = _step(angle, across, normal)
        lit = panel_share(angle, across, normal)
    field = wiener_hopf.edge_field(factors, *step, plan.step)
    fold = 1 / (1 - parities.kappa * jnp.cos(angle / 2) ** 2)
    fold = jnp.where(step[0] < wiener_hopf.FULL, jnp.zeros_like(fold), fold)

    def at(y: Array) -> Float[Array, " kappa"]:
        distance = -jnp.log(jnp.clip(y, 1e-14, 1))
        response = wiener_hopf.step_response(factors, field, step, distance, plan.step)
        return jnp.where(y == 0, fold, response)

    even, odd = parities.split(jax.vmap(at)(position))
    if isinstance(light, Diffuse):
        return jnp.stack(parities.diffusely_lit(even, odd))
    scale = 2 * jnp.sin(angle / 2)
    other = parities.coupling * odd
    return scale * jnp.stack([lit * first * even + (1 - lit) * other, (1 - lit) * second * even + lit * other])
