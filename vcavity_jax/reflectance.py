"""From a scene to its reflectance factor: check it, plan the least work that it needs, do that work.

Planning looks at what is known when the function is called. A view that is known to be frontal, an index that
is known to be real, panels that are known to be fully lit and seen: each drops the part of the model that the
scene does not need. What JAX traces is treated in full generality.
"""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from vcavity_jax import lambertian, roughness, specular, wiener_hopf
from vcavity_jax import resolution as plan_for
from vcavity_jax.directions import components, hidden_depth, panel_share
from vcavity_jax.lambertian import MeanResolution
from vcavity_jax.scene import (
    BeckmannGrooves,
    Diffuse,
    Directional,
    Lambertian,
    Mixed,
    Polarization,
    Scene,
    Specular,
    TwoPanels,
    VGrooves,
    _concrete,
)
from vcavity_jax.wiener_hopf import Resolution

_CLEARLY_VISIBLE = 0.01
"""A lit or seen part of a panel above which its rim layer needs no extra care."""

Step = tuple[Float[Array, ""], Float[Array, ""]]


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a scene needs, fixed before it is traced.

    Args:
        open: every panel is known to be fully lit and fully seen.
        balanced: light or view is known to meet both panels alike, so that one parity is enough.
        symmetric: every view is known to lie in the plane along the grooves.
        model: treatment of polarization that is exact for what the user asked.
        mean: sampling for G.
        step: sampling for shadows and masks.
        order: nodes per panel of an average over groove angles.
        cutoff: its largest slope.
        most: orders of kinks that it resolves.
    """

    open: bool
    balanced: bool
    symmetric: bool
    model: Polarization
    mean: MeanResolution
    step: Resolution
    order: int
    cutoff: float
    most: int


def _known_directions(scene: Scene) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]] | None:
    """Components of the view, then of the light if it is directional; None where one of them is traced."""
    light = scene.illumination.directional if isinstance(scene.illumination, Mixed) else scene.illumination
    parts = [scene.view, light] if isinstance(light, Directional) else [scene.view]
    known = [(_concrete(part.polar), _concrete(part.azimuth)) for part in parts]
    if any(value is None for pair in known for value in pair):
        return None
    return [
        (np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth), np.cos(polar))
        for polar, azimuth in known
    ]


def _plan(scene: Scene, tolerance: float) -> Plan:
    tolerance = plan_for.check_tolerance(tolerance)
    cutoff = plan_for.slope_cutoff(tolerance)
    directions = _known_directions(scene)
    in_fold_plane = [bool(np.all(np.abs(y) < 1e-15)) for _, y, _ in directions] if directions else [False]
    angle: float | None = None
    most = 0
    if isinstance(scene.surface, VGrooves):
        value = _concrete(scene.surface.angle)
        angle = None if value is None else float(np.min(value))
    else:
        value = _concrete(scene.surface.roughness)
        rough = 10.0 if value is None else max(float(np.max(value)), 1e-3)
        angle = 2 * float(np.arctan2(1, rough * cutoff))
        # A coarse ladder of orders keeps the number of compiled programs small.
        most = 2 ** int(np.ceil(np.log2(2 * np.pi / angle + 1)))
    visible: float | None = None
    fully = False
    if directions is not None:
        fully = all(in_fold_plane)
        if angle is not None:
            reach = [np.abs(y) * np.cos(angle / 2) - z * np.sin(angle / 2) for _, y, z in directions]
            if isinstance(scene.surface, VGrooves):
                fully = fully or bool(max(np.max(r) for r in reach) <= 0)
            narrowest = plan_for.planned_angle(angle)
            s, c = np.sin(narrowest / 2), np.cos(narrowest / 2)
            visible = min(float(np.min(2 * z * s / (np.abs(y) * c + z * s))) for _, y, z in directions)
            # Two cases only: every one is compiled for itself. Beyond, the rim layer is treated in full.
            visible = _CLEARLY_VISIBLE if visible >= _CLEARLY_VISIBLE else None
    model: Polarization = "full"
    if isinstance(scene.material, Specular):
        model = scene.material.polarization
        across_only = directions is not None and bool(np.all(np.abs(directions[0][0]) < 1e-15))
        if model == "full" and across_only:
            model = "separate"  # Without a component along the fold nothing couples s and p.
    return Plan(
        open=fully,
        balanced=any(in_fold_plane),
        symmetric=in_fold_plane[0],
        model=model,
        mean=plan_for.mean_resolution(tolerance, angle),
        step=plan_for.step_resolution(tolerance, angle, visible),
        order=plan_for.panel_order(tolerance),
        cutoff=cutoff,
        most=most,
    )


def reflectance_factor(
    scene: Scene, tolerance: float = 1e-8
) -> Float[Array, "*directions_and_wavelengths"]:
    """Reflectance factor of a scene: its radiance seen from afar over that of a perfect white flat diffuser.

    Under diffuse light it is the hemispherical-directional reflectance factor, by reciprocity also the
    directional-hemispherical reflectance. The radiance is averaged over the projected visible area.

    It is continuous in every parameter. Its gradient jumps where the number of reflections or the visible part
    of a panel changes (``kinks.kink_angles``); there it is the gradient of one side, and finite.

    Args:
        scene: the surface, material, illumination and view.
        tolerance: upper bound on the absolute numerical error, 0 < tolerance < 1; a plain number. In float64
            it can be kept down to 1e-13 (1e-11 below 5 degrees), in float32 down to 1e-5 above 20 degrees.

    Returns:
        Fraction, of shape ``scene.view.shape`` followed by the material's wavelength shape.

    Raises:
        ValueError: the scene has no finite answer, combines parts that the models do not cover, or the
            tolerance is not a plain number between 0 and 1.

    References:
        [SaintPierre2020, chapters 3 and 4], with the corrections of docs/errata.md.
    """
    _check(scene)
    return _evaluate(_with_safe_index(scene), _plan(scene, tolerance))


def _check(scene: Scene) -> None:
    if isinstance(scene.material, Specular) and not isinstance(scene.illumination, Diffuse):
        raise ValueError(
            "a specular groove under directional light, seen from one direction, has no finite reflectance "
            "factor (it is a delta function): use Diffuse() light"
        )
    if isinstance(scene.surface, BeckmannGrooves) and not isinstance(scene.illumination, Diffuse):
        raise ValueError("randomly grooved surfaces are modeled under Diffuse() light only")


def _with_safe_index(scene: Scene) -> Scene:
    """A real index stays real only where it is known to be at least 1: below, the angle of refraction may not."""
    if not isinstance(scene.material, Specular) or jnp.iscomplexobj(scene.material.index):
        return scene
    value = _concrete(scene.material.index)
    if value is not None and bool(np.all(value >= 1)):
        return scene
    index = scene.material.index
    return eqx.tree_at(lambda s: s.material.index, scene, jax.lax.complex(index, jnp.zeros_like(index)))


@eqx.filter_jit
def _evaluate(scene: Scene, plan: Plan) -> Array:
    polar, azimuth = jnp.broadcast_arrays(scene.view.polar, scene.view.azimuth)
    directions = components(polar.ravel(), azimuth.ravel())
    if isinstance(scene.material, Specular):
        wavelength_shape = scene.material.index.shape
        value = _specular(scene, directions, plan)
    else:
        panels = _panels(scene.material)
        wavelength_shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in panels))
        first, second = (jnp.broadcast_to(p, wavelength_shape).ravel() for p in panels)
        value = _diffusing(scene, (first, second), directions, plan)
        if isinstance(scene.material, TwoPanels) and scene.material.alternating:
            value = (value + _diffusing(scene, (second, first), directions, plan)) / 2
    return jnp.reshape(value, (*scene.view.shape, *wavelength_shape))


def _specular(scene: Scene, directions: tuple[Array, Array, Array], plan: Plan) -> Float[Array, "d w"]:
    assert isinstance(scene.material, Specular)
    geometry = tuple(component[:, None] for component in directions)
    index = scene.material.index.ravel()
    if isinstance(scene.surface, VGrooves):
        angle = jnp.minimum(scene.surface.angle, jnp.asarray(jnp.pi, scene.surface.angle.dtype))
        return specular.hemispherical_directional(angle, *geometry, index, plan.model, plan.symmetric)
    return roughness.specular_average(
        scene.surface.roughness,
        *geometry,
        index,
        plan.model,
        plan.symmetric,
        plan.order,
        plan.cutoff,
        plan.most,
    )


def _panels(material: Lambertian | TwoPanels | Specular) -> tuple[Array, Array]:
    if isinstance(material, TwoPanels):
        return material.first.reflectance, material.second.reflectance
    assert isinstance(material, Lambertian)
    return material.reflectance, material.reflectance


@dataclasses.dataclass(frozen=True)
class _Parities:
    """The two panels' radiosity as problems of one panel: κ = ρ and, unless the panels see alike, κ = -ρ."""

    first: Float[Array, " wavelengths"]
    second: Float[Array, " wavelengths"]
    alike: bool
    one_parity: bool

    @property
    def coupling(self) -> Float[Array, " wavelengths"]:
        """ρ = √(r₁ r₂), with a gradient where one panel is black."""
        if self.alike:
            return self.first
        product = self.first * self.second
        dark = jnp.asarray(1e-14 if product.dtype == jnp.float64 else 1e-7, product.dtype)
        return jnp.sqrt(jnp.where(product < 1e-6, product + dark, product))

    @property
    def kappa(self) -> Float[Array, " kappa"]:
        return self.coupling if self.one_parity else jnp.concatenate([self.coupling, -self.coupling])

    def split(self, value: Float[Array, "... kappa"]) -> tuple[Array, Array]:
        """Even part, and odd part over ρ, of a function of κ."""
        plus, minus = jnp.split(value, 2, axis=-1)
        return (plus + minus) / 2, (plus - minus) / (2 * self.coupling)


def _diffusing(
    scene: Scene, reflectances: tuple[Array, Array], directions: tuple[Array, Array, Array], plan: Plan
) -> Float[Array, "d w"]:
    light = scene.illumination
    alike = isinstance(scene.material, Lambertian)
    if isinstance(scene.surface, BeckmannGrooves):
        return _diffusing_average(scene.surface.roughness, reflectances, alike, directions, plan)
    angle = jnp.minimum(scene.surface.angle, jnp.asarray(jnp.pi, scene.surface.angle.dtype))
    total = jnp.zeros((directions[0].shape[0], reflectances[0].shape[0]), reflectances[0].dtype)
    if not isinstance(light, Directional):
        diffuse = _diffuse(angle, reflectances, alike, directions, plan, plan.open)
        if isinstance(light, Diffuse):
            return diffuse
        total = light.diffuse_fraction * diffuse
        share = 1 - light.diffuse_fraction
        light = light.directional
    else:
        share = jnp.ones((), total.dtype)
    return total + share * _directional(angle, reflectances, alike, light, directions, plan)


def _diffuse(
    angle: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    directions: tuple[Array, Array, Array],
    plan: Plan,
    fully_seen: bool,
) -> Float[Array, "d w"]:
    """Diffuse light: HDR = 1 - (1 - r) T̃, where T̃ is the mean response over what a view sees."""
    _, across, normal = directions
    parities = _Parities(*reflectances, alike, one_parity=alike)
    if fully_seen:
        mean = lambertian.mean_response(angle, parities.kappa, plan.mean)
        means = jnp.broadcast_to(mean, (across.shape[0], mean.shape[0]))
    else:
        factors = lambertian.factorize(angle, parities.kappa, plan.step)
        depth, visible = hidden_depth(angle, across, normal)
        distance = wiener_hopf.log_distance(depth, visible)
        means = jax.vmap(lambda a, v: wiener_hopf.step_mean(factors, a, v, plan.step))(distance, visible)
    first, second = reflectances
    if alike:
        return 1 - (1 - first) * means
    even, odd = parities.split(means)
    share = panel_share(angle, across, normal)[:, None]
    seen_first = 1 - (1 - first) * even - first * (1 - second) * odd
    seen_second = 1 - (1 - second) * even - second * (1 - first) * odd
    return share * seen_first + (1 - share) * seen_second


def _directional(
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
    parities = _Parities(*reflectances, alike, one_parity=alike and plan.balanced)
    if plan.open:
        mean = lambertian.mean_response(angle, parities.kappa, plan.mean)
        means = jnp.broadcast_to(mean, (across.shape[0], mean.shape[0]))
    else:
        factors = lambertian.factorize(angle, parities.kappa, plan.step)

        def step_of(y: Array, z: Array) -> Step:
            depth, visible = hidden_depth(angle, y, z)
            return wiener_hopf.log_distance(depth, visible), visible

        lit_step = step_of(light_across, light_normal)
        field = wiener_hopf.edge_field(factors, *lit_step, plan.step)
        pair = partial(wiener_hopf.step_step, factors, field, lit_step, resolution=plan.step)
        means = jax.vmap(pair)(step_of(across, normal))
    first, second = reflectances
    scale = 2 * jnp.sin(angle / 2)
    if parities.one_parity:
        return scale * first * means / 2
    even, odd = parities.split(means)
    same = seen * lit * first + (1 - seen) * (1 - lit) * second
    other = seen * (1 - lit) + (1 - seen) * lit
    return scale * (same * even + other * first * second * odd)


def radiance_profile(
    scene: Scene, position: Float[Array, "*positions"] | float, tolerance: float = 1e-8
) -> Float[Array, "2 *positions_and_wavelengths"]:
    """Local radiance along both panels of a diffusing groove; it does not depend on the view.

    Args:
        scene: ``VGrooves`` of ``Lambertian`` or ``TwoPanels``; its view is not used.
        position: distance from the fold in panel widths, 0 to 1, any shape.
        tolerance: upper bound on the absolute numerical error for positions above 1e-6; nearer to the fold,
            but for the fold itself, rounding grows as 1e-16 / √position.

    Returns:
        First panel (y < 0), then second, in units of the radiance of a flat white diffuser in the same light;
        shape (2,) + position.shape + wavelength shape.

    Raises:
        ValueError: the panels are specular, the groove angle is random, or a known position lies outside 0 to 1.

    References:
        [SaintPierre2020, sections 3.3 to 3.5].
    """
    if isinstance(scene.material, Specular) or isinstance(scene.surface, BeckmannGrooves):
        raise ValueError("a radiance profile needs diffusing panels and one groove angle: Lambertian, VGrooves")
    position = jnp.asarray(position, jnp.result_type(float))
    value = _concrete(position)
    if value is not None and not np.all((value >= 0) & (value <= 1)):
        raise ValueError(f"{value} is not a position on a panel: expected 0 (fold) to 1 (rim)")
    plan = dataclasses.replace(
        _plan(scene, tolerance),
        step=plan_for.step_resolution(plan_for.check_tolerance(tolerance), None, None),
    )
    return _profile(scene, position, plan)


@eqx.filter_jit
def _profile(scene: Scene, position: Array, plan: Plan) -> Array:
    assert isinstance(scene.surface, VGrooves)
    panels = _panels(scene.material)
    wavelength_shape = jnp.broadcast_shapes(*(jnp.shape(p) for p in panels))
    first, second = (jnp.broadcast_to(p, wavelength_shape).ravel() for p in panels)
    angle = jnp.minimum(scene.surface.angle, jnp.asarray(jnp.pi, scene.surface.angle.dtype))
    value = _local(scene.illumination, angle, (first, second), position.ravel(), plan)
    if isinstance(scene.material, TwoPanels) and scene.material.alternating:
        swapped = _local(scene.illumination, angle, (second, first), position.ravel(), plan)
        value = (value + swapped[::-1]) / 2
    return jnp.reshape(value, (2, *position.shape, *wavelength_shape))


def _local(
    light: Diffuse | Directional | Mixed,
    angle: Array,
    reflectances: tuple[Array, Array],
    position: Array,
    plan: Plan,
) -> Float[Array, "2 p w"]:
    """Radiance at some positions, for two panels in general."""
    if isinstance(light, Mixed):
        diffuse = _local(Diffuse(), angle, reflectances, position, plan)
        directional = _local(light.directional, angle, reflectances, position, plan)
        return light.diffuse_fraction * diffuse + (1 - light.diffuse_fraction) * directional
    first, second = reflectances
    parities = _Parities(first, second, alike=False, one_parity=False)
    factors = lambertian.factorize(angle, parities.kappa, plan.step)
    everywhere = jnp.zeros((), position.dtype), jnp.ones((), position.dtype)
    lit = jnp.full((), 0.5, position.dtype)
    depth, visible = everywhere
    if isinstance(light, Directional):
        _, across, normal = components(light.polar, light.azimuth)
        depth, visible = hidden_depth(angle, across, normal)
        lit = panel_share(angle, across, normal)
    step = wiener_hopf.log_distance(depth, visible), visible
    field = wiener_hopf.edge_field(factors, *step, plan.step)
    safe = jnp.clip(position, 1e-14, 1)

    def at(y: Array) -> Float[Array, " kappa"]:
        return wiener_hopf.step_response(factors, field, step, -jnp.log(y), plan.step)

    fold = 1 / (1 - parities.kappa * jnp.cos(angle / 2) ** 2)
    response = jnp.where((position == 0)[:, None], jnp.where(depth > 0, jnp.zeros_like(fold), fold), jax.vmap(at)(safe))
    even, odd = parities.split(response)
    if isinstance(light, Diffuse):
        return jnp.stack(
            [
                1 - (1 - first) * even - first * (1 - second) * odd,
                1 - (1 - second) * even - second * (1 - first) * odd,
            ]
        )
    scale = 2 * jnp.sin(angle / 2)
    other = first * second * odd
    return scale * jnp.stack(
        [lit * first * even + (1 - lit) * other, (1 - lit) * second * even + lit * other]
    )


def _diffusing_average(
    m: Array,
    reflectances: tuple[Array, Array],
    alike: bool,
    directions: tuple[Array, Array, Array],
    plan: Plan,
) -> Float[Array, "d w"]:
    """Randomly grooved diffusing surface under diffuse light."""

    def one(along: Array, across: Array, normal: Array) -> Float[Array, " w"]:
        direction = (along[None], across[None], normal[None])

        def at(fully_seen: bool) -> partial[Array]:
            return partial(_at_angle, reflectances, alike, direction, plan, fully_seen)

        section = jnp.arctan2(across, normal)
        masked = None if plan.open else at(False)
        return roughness.lambertian_average(m, section, at(True), masked, plan.order, plan.cutoff)

    return jax.vmap(one)(*directions)


def _at_angle(
    reflectances: tuple[Array, Array],
    alike: bool,
    direction: tuple[Array, Array, Array],
    plan: Plan,
    fully_seen: bool,
    angle: Array,
) -> Float[Array, " w"]:
    return _diffuse(angle, reflectances, alike, direction, plan, fully_seen)[0]
