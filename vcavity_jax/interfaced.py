"""Diffusing panels under a smooth interface: the symbol of their exchange, and what a direction lights or sees.

Between two points of the diffusing material light leaves through the interface, is reflected by the panels any
number of times, and enters again. Unfolded at the panels the groove is a fan of images; the image behind k
reflections is at the angle ψ = (k + 1)α, on the other panel for even k and on the same one for odd k. All these
exchanges are convolutions in t = -ln(distance from the fold), so that the engine of ``wiener_hopf`` serves them.
docs/interfaced.md derives the formulas.
"""

import dataclasses
from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Complex, Float, Inexact

from vcavity_jax import fresnel, wiener_hopf
from vcavity_jax.bands import Bands
from vcavity_jax.directions import hidden_depth, panel_share
from vcavity_jax.fresnel import Jones
from vcavity_jax.safe import elementwise_forward, safe_hypot
from vcavity_jax.wiener_hopf import Resolution


@dataclasses.dataclass(frozen=True)
class InterfaceResolution:
    """How finely an interfaced groove is sampled, and how many of its orders are kept.

    Args:
        contour: of the factorization.
        tilt: of the path of the symbol, radians; larger than the contour's.
        step: spacing on that path.
        reach: its end in t.
        order: nodes over the tilt η of rays along the fold.
        images: how many images of the panels are kept, one less than the specular orders between them.
        hits: how many panels a ray from outside meets at most, before it enters.
    """

    contour: Resolution
    tilt: float
    step: float
    reach: float
    order: int
    images: int
    hits: int


class Interface(NamedTuple):
    """The smooth interface of the panels, and what absorbs above the diffusing material.

    Args:
        n: refractive index, ≥ 1, shape ().
        depth: optical depth -ln t of a clear colored layer, shape (), or None for none.
        polarized: whether the polarization is followed along each path; else powers are multiplied.
    """

    n: Float[Array, ""]
    depth: Float[Array, ""] | None
    polarized: bool


class Exchange(NamedTuple):
    """Symbols of the exchange between the two panels and of a panel with itself, on the inner contour.

    ``entering`` is that of light that leaves through a clear interface and enters through the layer, for both
    directions of the path, (k̂(τ), k̂(-τ)): what diffuse light falls short of by the shade of the groove. It is
    None without a layer, being the sum of the other two.
    """

    cross: Complex[Array, " inner"]
    same: Complex[Array, " inner"]
    entering: tuple[Complex[Array, " inner"], Complex[Array, " inner"]] | None


@lru_cache(maxsize=64)
def _path(resolution: InterfaceResolution) -> tuple[np.ndarray, np.ndarray]:
    """Half the path of the symbol, sinh(x + i tilt), and its slope times the step; the other half is conjugate."""
    width = min(resolution.contour.smallest_angle, 1.2)
    nodes = np.arcsinh(resolution.reach / width / np.cos(resolution.tilt)) / resolution.step
    x = np.arange(int(np.ceil(nodes)) + 1) * resolution.step + 1j * resolution.tilt
    slope = resolution.step * np.cosh(x)
    slope[0] /= 2
    return np.sinh(x), slope


@lru_cache(maxsize=64)
def _tilts(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cos η, sin η and weights 2 cos²η dη over 0 ≤ η ≤ π/2, clustered at π/2 where incidence is grazing."""
    x, weight = np.polynomial.legendre.leggauss(order)
    v, weight = (x + 1) / 2, weight / 2
    cosine = np.sin(np.pi / 2 * v * v)
    return cosine, np.cos(np.pi / 2 * v * v), 2 * weight * np.pi * v * cosine**2


def exchange(angle: Float[Array, ""], interface: Interface, resolution: InterfaceResolution) -> Exchange:
    """Symbols k̂(τ) of all images, in units of the diffuse transmittance t₁₂ of the clear interface.

    With u = exp(-t) and R = √(1 - 2u cos ψ + u²), k(t) = Σ sin²ψ u^(3/2) / R³ G / (π t₁₂), where
    G = 2 ∫ cos²η T(c₀) ∏ R(c_j) T(c_{k+1}) dη and c_j = cos η sin(γ + jα),
    sin(γ + jα) = [sin jα + u sin((k + 1 - j)α)] / R. The path in t is tilted with the contour.
    """
    depth = () if interface.depth is None else (interface.depth,)

    def symbols(angle: Array, n: Array, *depth: Array) -> Exchange:
        return _exchange(angle, Interface(n, depth[0] if depth else None, interface.polarized), resolution)

    # Two or three numbers in: their tangents are cheaper than the reverse pass, and compile several times faster.
    return elementwise_forward(symbols, nested=True)(angle, interface.n, *depth)


def _exchange(angle: Float[Array, ""], interface: Interface, resolution: InterfaceResolution) -> Exchange:
    shape, slope = _path(resolution)
    # The integral does not depend on the path, so neither does its derivative: the path may stay fixed.
    width = lax.stop_gradient(jnp.minimum(angle, 1.2))
    dtype = jnp.result_type(lax.complex(width, width))
    t = width.astype(dtype) * jnp.asarray(shape, dtype)
    # A path made for much narrower grooves runs on to where the kernel is nothing but its factors overflow.
    needed = t.real < 2 * resolution.reach
    t = jnp.where(needed, t, jnp.ones_like(t))
    u = jnp.exp(-t)
    image = jnp.arange(1, resolution.images + 1, dtype=angle.dtype)[:, None]
    live = image * angle < jnp.pi
    psi = jnp.where(live, image * angle, jnp.full_like(image, jnp.pi / 2))
    image = jnp.where(live, image, jnp.ones_like(image))
    turned = [-wiener_hopf.complex_expm1(-t.real, sign * psi - t.imag) for sign in (1, -1)]
    inverse = fresnel.reciprocal(fresnel.square_root(turned[0]) * fresnel.square_root(turned[1]))
    sine = jnp.sin(psi).astype(dtype)
    measure = sine * sine * jnp.exp(-1.5 * t) * inverse**3
    measure = measure * width.astype(dtype) * jnp.asarray(slope, dtype)
    measure = jnp.where(live & needed, measure, jnp.zeros_like(measure))
    gain, mixed = _transfer(angle, psi, image, u, inverse, interface, resolution)
    scale = (1 / (jnp.pi * fresnel.diffuse_transmittance(interface.n))).astype(dtype)
    density = measure * gain * scale
    tau = jnp.asarray(wiener_hopf.contour(resolution.contour).tau, dtype)
    tau = tau[: wiener_hopf.contour(resolution.contour).inner]
    forward, backward = 1j * tau[:, None] * t, -1j * tau[:, None] * t.conj()
    waves = jnp.exp(forward), jnp.exp(backward)
    odd = (jnp.mod(image, 2) == 0).astype(dtype)

    def symbol(ahead: Array, behind: Array) -> Array:
        return waves[0] @ ahead + waves[1] @ behind.conj()

    same = jnp.sum(odd * density, axis=0)
    cross = jnp.sum(density, axis=0) - same
    entering = None
    if mixed is not None:
        ahead, behind = (jnp.sum(measure * part * scale, axis=0) for part in mixed)
        entering = symbol(ahead, behind), symbol(behind, ahead)
    return Exchange(symbol(cross, cross), symbol(same, same), entering)


def _transfer(
    angle: Float[Array, ""],
    psi: Float[Array, "images 1"],
    image: Float[Array, "images 1"],
    u: Complex[Array, " t"],
    inverse: Complex[Array, "images t"],
    interface: Interface,
    resolution: InterfaceResolution,
) -> tuple[Complex[Array, "images t"], tuple[Array, Array] | None]:
    """G of all images along the path; with a layer also what enters through it at the deep and at the near end."""
    dtype = u.dtype
    beside, along, weight = (jnp.asarray(a, dtype) for a in _tilts(resolution.order))

    def facing(j: float | Array) -> tuple[Array, Array]:
        """Sine and cosine of the angle γ + jα between a ray and panel j of the fan."""
        own = jnp.broadcast_to(jnp.asarray(j * angle), psi.shape)
        sine = (jnp.sin(own).astype(dtype) + u * jnp.sin(psi - own).astype(dtype)) * inverse
        cosine = (jnp.cos(own).astype(dtype) - u * jnp.cos(psi - own).astype(dtype)) * inverse
        return sine[..., None], cosine[..., None]

    near, far = facing(0.0), facing(psi / angle)
    ends = beside * near[0], beside * far[0]
    path = _Path(interface, along)
    state = path.begin(ends[0], near)

    def further(state: Jones, j: Array) -> tuple[Jones, None]:
        panel, inner = facing(j), (j < image)[..., None]
        # Beyond an image's own panels the chain is at its end: a harmless reflection, so no gradient meets 0/0.
        panel = jnp.where(inner, panel[0], jnp.full_like(panel[0], 0.5)), panel[1]
        following = path.reflected(state, beside * panel[0], panel)
        return tuple(jnp.where(inner, new, old) for new, old in zip(following, state, strict=True)), None

    state, _ = lax.scan(further, state, jnp.arange(1, resolution.images, dtype=angle.dtype))
    power = path.end(state, ends[1], far)
    if interface.depth is None:
        return power @ weight, None
    at_near, at_far = (jnp.exp(-interface.depth.astype(c.dtype) * path_length(c, interface.n)) for c in ends)
    return (power * at_near * at_far) @ weight, ((power * at_far) @ weight, (power * at_near) @ weight)


def path_length(cosine: Inexact[Array, "..."], index: Float[Array, "..."]) -> Inexact[Array, "..."]:
    """Way through a layer below the interface, n / S in units of its thickness."""
    return index.astype(cosine.dtype) * fresnel.reciprocal(fresnel.refracted(cosine, index))


@dataclasses.dataclass(frozen=True)
class _Path:
    """The power of a ray along its way: a product of powers, or a chain of 2 × 2 matrices of amplitudes.

    A panel is given by sine and cosine of the angle that the ray's section makes with it; cos η sin(angle) is
    the cosine of the angle of incidence, and (cos, -sin η sin) the transverse part of the panel's normal.
    """

    interface: Interface
    along: Inexact[Array, "..."]

    def outside(self, shape: tuple[int, ...], dtype: Any) -> Jones:
        """A ray that has met nothing."""
        one = jnp.ones(shape, dtype)
        if not self.interface.polarized:
            return (one,)
        return one, jnp.zeros_like(one), jnp.zeros_like(one), one

    def begin(self, cosine: Array, panel: tuple[Array, Array]) -> Jones:
        """A ray that has left a panel's material."""
        if not self.interface.polarized:
            return (fresnel.transmittance(cosine, self.interface.n),)
        a, b, factor = fresnel.transmission_operator(cosine, self.interface.n)
        start = self.outside(jnp.shape(cosine), cosine.dtype)
        # The power's factor enters with its root, which no later step needs but the squares do.
        root = fresnel.square_root(factor)
        return self._turned(start, a * root, b * root, panel)

    def reflected(self, state: Jones, cosine: Array, panel: tuple[Array, Array]) -> Jones:
        """The ray after one more reflection."""
        if not self.interface.polarized:
            return (state[0] * fresnel.reflectance(cosine, self.interface.n),)
        return self._turned(state, *fresnel.reflection_operator(cosine, self.interface.n), panel)

    def end(self, state: Jones, cosine: Array, panel: tuple[Array, Array]) -> Inexact[Array, "..."]:
        """Power that enters a panel's material."""
        if not self.interface.polarized:
            return state[0] * fresnel.transmittance(cosine, self.interface.n)
        a, b, factor = fresnel.transmission_operator(cosine, self.interface.n)
        return factor * self.power(self._turned(state, a, b, panel))

    def power(self, state: Jones) -> Inexact[Array, "..."]:
        """Power of the ray."""
        if not self.interface.polarized:
            return state[0]
        return sum((e * e for e in state[1:]), start=state[0] * state[0]) / 2

    def _turned(self, state: Jones, a: Array, b: Array, panel: tuple[Array, Array]) -> Jones:
        sine, cosine = panel
        return fresnel.turned(state, a, b, cosine, -self.along * sine)


def bands(
    angle: Float[Array, ""],
    along: Float[Array, ""],
    across: Float[Array, ""],
    normal: Float[Array, ""],
    interface: Interface,
    hits: int,
) -> Bands:
    """The bands of one direction, one per side and hit.

    With β_j = α/2 ± θ' + (j - 1)α the ray's angle to the j-th panel it meets, the band reaches from
    max(0, sin β₀) / sin β_j to min(1, sin β₁ / sin β_j).

    Args:
        angle: dihedral angle, radians.
        along: e_x of the direction (along the fold).
        across: e_y (across the grooves).
        normal: e_z, ≥ 0.
        interface: of the panels.
        hits: how many to follow.
    """
    # What is narrower than this cannot be told from a point: next to grazing is grazing.
    least = float(jnp.finfo(normal.dtype).eps) ** 0.7
    normal = jnp.where(normal < least, jnp.zeros_like(normal), normal)
    paths = followed(angle, along, across, normal, interface, hits)
    section, first, share, sine = paths.section, paths.first, paths.share, paths.sine
    hidden = first > angle
    order = jnp.arange(1, hits + 1, dtype=angle.dtype)[:, None]
    # The band's length times sin β_j, half of it where the other panel hides a part.
    opening = jnp.sin(order * angle / 2) * jnp.cos(section + (order - 1) * angle / 2)
    alive = paths.alive & (share > 0) & (~hidden | (opening > 0) | (order == 1))
    extent = jnp.where(hidden, jnp.where(alive, opening, jnp.ones_like(opening)), sine)
    clipped = (sine < sine[0]) & alive
    ratio = jnp.where(clipped, extent / jnp.where(extent[0] > 0, extent[0], jnp.ones_like(extent[0])), 1.0)
    depth, visible = hidden_depth(angle, across, normal)
    cut = hidden & clipped
    width = jnp.where(cut, 2 * extent / sine, jnp.where(hidden, visible, jnp.ones_like(sine)))
    depth = jnp.where(cut, 1 - width, jnp.where(hidden, depth, jnp.zeros_like(sine)))
    mass = share * jnp.minimum(ratio, 1) * paths.entered
    outer = jnp.where(clipped | ~alive, jnp.zeros_like(sine), jnp.log(sine / sine[0]))
    return Bands(
        outer.ravel(),
        wiener_hopf.log_distance(depth, width).ravel(),
        width.ravel(),
        jnp.where(alive, mass, jnp.zeros_like(mass)).ravel(),
        paths.sign.ravel(),
    )


class Paths(NamedTuple):
    """The rays of one direction, by the panel that they meet first (last axis): what becomes of them at each hit.

    Args:
        section: ±θ', positive where the panel faces the direction, shape (2,).
        first: β₁, shape (2,).
        share: of the aperture that the panel fills, shape (2,).
        alive: whether there is such a hit, for rays near enough to the fold, shape (hits, 2).
        sine: sin β_j.
        ratio: sin β₁ / sin β_j, of the distances from the fold.
        sign: 1 where the hit is on the first panel, -1 on the second.
        entered: what enters there.
        passed: what goes on.
    """

    section: Float[Array, "2"]
    first: Float[Array, "2"]
    share: Float[Array, "2"]
    alive: Bool[Array, "hits 2"]
    sine: Float[Array, "hits 2"]
    ratio: Float[Array, "hits 2"]
    sign: Float[Array, "hits 2"]
    entered: Float[Array, "hits 2"]
    passed: Float[Array, "hits 2"]


def followed(
    angle: Float[Array, ""],
    along: Float[Array, ""],
    across: Float[Array, ""],
    normal: Float[Array, ""],
    interface: Interface,
    hits: int,
) -> Paths:
    """Follow the rays of one direction; arguments as for ``bands``."""
    side = jnp.asarray([1.0, -1.0], angle.dtype)
    vertical = (across == 0) & (normal == 0)
    section = side * jnp.arctan2(across, jnp.where(vertical, jnp.ones_like(normal), normal))
    first = angle / 2 + section
    order = jnp.arange(1, hits + 1, dtype=angle.dtype)[:, None]
    beta = first + (order - 1) * angle
    alive = (first > 0) & (beta < jnp.pi)
    beta = jnp.where(alive, beta, jnp.ones_like(beta))
    sine = jnp.sin(beta)
    sign = side * (1 - 2 * jnp.mod(order - 1, 2))
    share = panel_share(angle, side * across, normal)
    entered, passed = _entering(interface, along, across, normal, alive, beta)
    return Paths(section, first, share, alive, sine, sine[0] / sine, sign, entered, passed)


def no_bands(like: Array) -> Bands:
    """Nothing."""
    return Bands(*(jnp.zeros(0, like.dtype) for _ in Bands._fields))


def _entering(
    interface: Interface,
    along: Float[Array, ""],
    across: Float[Array, ""],
    normal: Float[Array, ""],
    alive: Bool[Array, "hits 2"],
    beta: Float[Array, "hits 2"],
) -> tuple[Float[Array, "hits 2"], Float[Array, "hits 2"]]:
    """What of a ray enters at each of its hits, and what is reflected on."""
    path = _Path(interface, along)
    beside = safe_hypot(across, normal)

    def next_hit(state: Jones, hit: tuple[Array, Array]) -> tuple[Jones, tuple[Array, Array]]:
        live, angle = hit
        panel = jnp.sin(angle), jnp.cos(angle)
        cosine = beside * panel[0]
        entered = path.end(state, cosine, panel)
        if interface.depth is not None:
            entered = entered * jnp.exp(-interface.depth * path_length(cosine, interface.n))
        following = path.reflected(state, cosine, panel)
        state = tuple(jnp.where(live, new, old) for new, old in zip(following, state, strict=True))
        return state, (entered, path.power(state))

    return lax.scan(next_hit, path.outside((2,), beta.dtype), (alive, beta))[1]
