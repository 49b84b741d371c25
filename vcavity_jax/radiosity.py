"""How panels, light and view of a diffusing groove are put together: means and local radiances.

Two panels of reflectances r₁ and r₂ separate into two problems of one panel, κ = ±ρ with ρ = √(r₁ r₂). A
light or a view that meets only one panel is a step on that panel; one that meets both is uniform on each, in
the shares of the aperture that they fill [docs/lambertian.md].
"""

import dataclasses
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from vcavity_jax import illumination, lambertian, wiener_hopf
from vcavity_jax.directions import components, hidden_depth, panel_share
from vcavity_jax.illumination import Section, Steps
from vcavity_jax.planning import Plan
from vcavity_jax.quadrature import Clustering
from vcavity_jax.safe import safe_divide
from vcavity_jax.scene import Annular, Diffuse, DiffuseWithTrap, Directional, Mixed

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


def bihemispherical(
    angle: Array, reflectances: tuple[Array, Array], alike: bool, plan: Plan
) -> Float[Array, " w"]:
    """Reflected over incident flux in diffuse light: 1 - Σ (1 - r) E / 2s, with E the panels' irradiances."""
    first, second = reflectances
    opening = jnp.sin(angle / 2)
    if alike:
        exchange = lambertian.mean_exchange(angle, first, plan.mean)
        return 1 - (1 - first) / opening * (1 - (1 - first) * exchange)
    same, other = lambertian.mean_exchanges(angle, first * second, plan.mean)
    on_first = 1 - (1 - first) * second * same - (1 - second) * other
    on_second = 1 - (1 - second) * first * same - (1 - first) * other
    return 1 - ((1 - first) * on_first + (1 - second) * on_second) / (2 * opening)


def annular(
    angle: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    polar: Array,
    directions: tuple[Array, Array, Array],
    plan: Plan,
    clustering: Clustering,
    open_lit: bool,
    open_seen: bool,
) -> Float[Array, "d w"]:
    """A ring of light, by symmetry alike on both panels: like panels need one parity only.

    Args:
        angle: dihedral angle, radians.
        reflectances: of the two panels, shape (W,).
        alike: they are the same.
        polar: of the ring, radians.
        directions: components of the views, each of shape (D,).
        plan: its ``mean`` where all is open, its ``step`` elsewhere.
        clustering: nodes of the ring.
        open_lit: the ring is known to be free of shadow, polar ≤ α/2.
        open_seen: all views are known to be free of masks.
    """
    parities = Parities(*reflectances, alike, one_parity=alike, darkest=plan.darkest)
    light = partial(illumination.ring, angle, polar, None if open_lit else clustering)
    means = _lit_means(angle, parities.kappa, light, directions, plan, open_lit, open_seen)
    return _radiance(angle, parities, means, panel_share(angle, *directions[1:]))


def annular_hemispherical(
    angle: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    polar: Array,
    plan: Plan,
    clustering: Clustering,
    open_lit: bool,
) -> Float[Array, " w"]:
    """Reflected over incident flux under a ring of light: the mean of ``diffuse`` over a ring of views."""
    parities = Parities(*reflectances, alike, one_parity=alike, darkest=plan.darkest)
    if open_lit:
        mean = lambertian.mean_response(angle, parities.kappa, plan.mean)
    else:
        factors = lambertian.factorize(angle, parities.kappa, plan.step)
        steps = illumination.ring(angle, polar, clustering)
        mean = jnp.sum(_step_means(factors, steps, plan), axis=0)
    if alike:
        return 1 - (1 - parities.first) * mean
    first, second = parities.diffusely_lit(*parities.split(mean))
    return (first + second) / 2


def trapped(
    angle: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    light: DiffuseWithTrap,
    directions: tuple[Array, Array, Array],
    plan: Plan,
    clustering: Clustering,
    open_lit: bool,
    open_seen: bool,
) -> Float[Array, "d w"]:
    """Diffuse light less a dark disk, relative to a white diffuser in the same light.

    Args:
        angle: dihedral angle, radians.
        reflectances: of the two panels, shape (W,).
        alike: they are the same.
        light: the disk.
        directions: components of the views, each of shape (D,).
        plan: its ``mean`` where all is open, its ``step`` elsewhere.
        clustering: nodes of the disk.
        open_lit: the disk is known to be free of shadow, |θ'| ≤ α/2 everywhere.
        open_seen: all views are known to be free of masks.
    """
    parities = Parities(*reflectances, alike, one_parity=alike and plan.balanced, darkest=plan.darkest)
    missing = partial(illumination.disk, angle, light, None if open_lit else clustering)
    means = _lit_means(angle, parities.kappa, missing, directions, plan, open_lit, open_seen)
    dark = _radiance(angle, parities, means, panel_share(angle, *directions[1:]))
    whole = diffuse(angle, reflectances, alike, directions, plan, open_seen)
    return (whole - dark) / (1 - illumination.disk_irradiance(light))


_VIEWS_AT_ONCE = 8
"""Views whose nodes of light are in memory together."""


def _step_means(factors: wiener_hopf.Factorization, steps: Steps, plan: Plan) -> Float[Array, "2 kappa"]:
    """Mean responses to a light as seen by a view that meets both panels alike."""
    mean_of = partial(wiener_hopf.step_mean, factors, resolution=plan.step)
    values = jax.vmap(mean_of)(steps.distance, steps.visible)
    return steps.uniform[:, None] * factors.mean + steps.weight.T @ values


def _lit_means(
    angle: Array,
    kappa: Array,
    light: Callable[[Section | None], Steps],
    directions: tuple[Array, Array, Array],
    plan: Plan,
    open_lit: bool,
    open_seen: bool,
) -> Float[Array, "d 2 kappa"]:
    """Mean over what each view sees of the response to a light, by the panel that the light falls on."""
    _, across, normal = directions
    if open_lit and open_seen:
        mean = lambertian.mean_response(angle, kappa, plan.mean)
        return jnp.broadcast_to(light(None).uniform[:, None] * mean, (across.shape[0], 2, mean.shape[0]))
    factors = lambertian.factorize(angle, kappa, plan.step)
    if open_seen:
        means = _step_means(factors, light(None), plan)
        return jnp.broadcast_to(means, (across.shape[0], *means.shape))

    def one(view: Section) -> Float[Array, "2 kappa"]:
        seen = _step(angle, *view)
        steps = light(None if open_lit else view)
        means = steps.uniform[:, None] * wiener_hopf.step_mean(factors, *seen, plan.step)
        if open_lit:
            return means
        field = wiener_hopf.edge_field(factors, *seen, plan.step)
        pair = partial(wiener_hopf.step_step, factors, field, seen, resolution=plan.step)
        return means + steps.weight.T @ jax.vmap(pair)((steps.distance, steps.visible))

    return lax.map(one, (across, normal), batch_size=_VIEWS_AT_ONCE)


def _radiance(
    angle: Array, parities: Parities, means: Float[Array, "d 2 kappa"], share: Float[Array, " d"]
) -> Float[Array, "d w"]:
    """From means by the panel that is lit to the radiance of both panels, each in its share of the view."""
    first, second = parities.first, parities.second
    scale = 2 * jnp.sin(angle / 2)
    if parities.one_parity:
        return scale * first * jnp.sum(means, axis=1) / 2
    even, odd = parities.split(means)
    other = parities.coupling * odd
    seen = share[:, None]
    return scale * (seen * (first * even[:, 0] + other[:, 1]) + (1 - seen) * (second * even[:, 1] + other[:, 0]))


def local_radiance(
    light: Diffuse | Directional | Mixed | Annular | DiffuseWithTrap,
    angle: Array,
    reflectances: tuple[Array, Array],
    position: Array,
    plan: Plan,
    clustering: Clustering | None = None,
) -> Float[Array, "2 p w"]:
    """Radiance of both panels at positions from 0 (fold) to 1 (rim); rings and traps need a clustering."""
    if isinstance(light, Mixed):
        diffuse = local_radiance(Diffuse(), angle, reflectances, position, plan)
        directional = local_radiance(light.directional, angle, reflectances, position, plan)
        return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
    first, second = reflectances
    parities = Parities(first, second, alike=False, one_parity=False, darkest=plan.darkest)
    factors = lambertian.factorize(angle, parities.kappa, plan.step)
    scale = 2 * jnp.sin(angle / 2)
    if isinstance(light, Annular | DiffuseWithTrap):
        assert clustering is not None
        if isinstance(light, Annular):
            steps_of: Callable[..., Steps] = partial(illumination.ring, angle, light.polar, clustering)
        else:
            steps_of = partial(illumination.disk, angle, light, clustering)
        even, odd = parities.split(_local_responses(factors, parities.kappa, steps_of, position, plan))
        other = parities.coupling * odd
        lit = scale * jnp.stack([first * even[0] + other[1], second * even[1] + other[0]])
        if isinstance(light, Annular):
            return lit
        whole = local_radiance(Diffuse(), angle, reflectances, position, plan)
        return (whole - lit) / (1 - illumination.disk_irradiance(light))
    step = jnp.full((), wiener_hopf.FULL, position.dtype), jnp.ones((), position.dtype)
    share = jnp.full((), 0.5, position.dtype)
    if isinstance(light, Directional):
        _, across, normal = components(light.polar, light.azimuth)
        step = _step(angle, across, normal)
        share = panel_share(angle, across, normal)
    field = wiener_hopf.edge_field(factors, *step, plan.step)
    fold = _fold(angle, parities.kappa)
    fold = jnp.where(step[0] < wiener_hopf.FULL, jnp.zeros_like(fold), fold)

    def at(y: Array) -> Float[Array, " kappa"]:
        response = wiener_hopf.step_response(factors, field, step, _distance(y), plan.step)
        return jnp.where(y == 0, fold, response)

    even, odd = parities.split(jax.vmap(at)(position))
    if isinstance(light, Diffuse):
        return jnp.stack(parities.diffusely_lit(even, odd))
    other = parities.coupling * odd
    return scale * jnp.stack(
        [share * first * even + (1 - share) * other, (1 - share) * second * even + share * other]
    )


def _distance(position: Array) -> Array:
    """-ln y, and that of 1e-14 for what is nearer to the fold."""
    return -jnp.log(jnp.clip(position, 1e-14, 1))


def _fold(angle: Array, kappa: Array) -> Array:
    """Response at the fold to uniform light."""
    return 1 / (1 - kappa * jnp.cos(angle / 2) ** 2)


def _local_responses(
    factors: wiener_hopf.Factorization,
    kappa: Array,
    light: Callable[[Section | None], Steps],
    position: Array,
    plan: Plan,
) -> Float[Array, "2 p kappa"]:
    """Response to a light at each position, by the panel that the light falls on.

    The edge correction is linear in the step and smooth in its depth: the mean one serves every node. What a
    position sees of the steps themselves jumps where their shadow passes it, so there the nodes part.
    """
    steps = light(None)
    none = jnp.zeros((2, *factors.edge.shape), factors.edge.dtype)

    def add(total: Array, step: tuple[Array, Array, Array]) -> tuple[Array, None]:
        distance, visible, weight = step
        field = wiener_hopf.edge_field(factors, distance, visible, plan.step)
        return total + weight.astype(field.dtype)[:, None, None] * field, None

    fields, _ = lax.scan(add, none, (steps.distance, steps.visible, steps.weight))
    amount = jnp.sum(steps.weight, axis=0)
    fields = safe_divide(fields, jnp.broadcast_to(amount[:, None, None], fields.shape).astype(fields.dtype))
    full = jnp.full((), wiener_hopf.FULL, position.dtype), jnp.ones((), position.dtype)
    full_field = wiener_hopf.edge_field(factors, *full, plan.step)
    fold = _fold(factors.angle, kappa)

    def at(y: Array) -> Float[Array, "2 kappa"]:
        half = factors.angle / 2
        steps = light(((1 + y) * jnp.sin(half), (1 - y) * jnp.cos(half)))
        pairs = steps.distance, steps.visible

        def response(field: Array, step: tuple[Array, Array]) -> Array:
            return wiener_hopf.step_response(factors, field, step, _distance(y), plan.step)

        partly = [
            weight @ jax.vmap(partial(response, field))(pairs)
            for weight, field in zip(steps.weight.T, fields, strict=True)
        ]
        lit = jnp.where(y == 0, fold, response(full_field, full))
        beyond = jnp.where(y == 0, jnp.zeros((2, len(fold)), fold.dtype), jnp.stack(partly))
        return steps.uniform[:, None] * lit + beyond

    return jnp.moveaxis(lax.map(at, position, batch_size=_VIEWS_AT_ONCE), 1, 0)
