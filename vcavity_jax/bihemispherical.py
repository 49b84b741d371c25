"""Bi-hemispherical reflectance of V-grooves with mirror-like panels: rays grouped by their reflections.

A ray that is reflected m times crosses m successive images of the panels, at angles that lie symmetrically
about π/2 but for a shift x. Reversing the path reverses x and keeps the reflectance, so

    R̄ = 4 / (π sin(α/2)) Σ_m ∫ w_m(x) ∫ cos²η R_m(η, x) dη dx,        0 ≤ x ≤ α/2, 0 ≤ η ≤ π/2,
    w_m(x) = cos(b + x) - max(cos(b + α - x), 0),        b = (m - 1) α/2,        m = 1 ... M = ceil(π/α)

with the angles of incidence c_j = cos η cos(x + (j - (m+1)/2) α). Chains of m and m + 2 reflections share the
inner ones: adding one at each end costs two reflections, the whole sum 2M - 1. The integrand is analytic between
the kinks of w_M and w_{M-1}, so Gauss-Legendre converges spectrally. docs/specular.md derives it.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Inexact

from vcavity_jax import fresnel
from vcavity_jax.fresnel import permittivity_contrast, power
from vcavity_jax.resolution import BihemisphericalResolution
from vcavity_jax.safe import elementwise_forward, floor_of, safe_hypot
from vcavity_jax.scene import Polarization

_ABRUPT = 1.0619
"""cosh of the |Im arccos c*| below which total external reflection is treated as abrupt."""

_GRAZING = 1e-3
"""Critical cosines below this matter to no one: 1e-6 of the light comes from there."""

Jones = tuple[Inexact[Array, "..."], ...]


def unit_legendre(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    node, weight = np.polynomial.legendre.leggauss(order)
    return (1 + node) / 2, weight / 2


def reflections_at_most(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    """M = ceil(π/α), the largest number of reflections, without gradient; at π/k, k + 1 would serve as well."""
    return lax.stop_gradient(jnp.maximum(jnp.ceil(jnp.pi / angle), 1))


def _amplitudes(
    cosine: Float[Array, "..."], contrast: Inexact[Array, "..."]
) -> tuple[Inexact[Array, "..."], Inexact[Array, "..."]]:
    """``fresnel.amplitudes`` for Im contrast ≥ 0 in half the time: roots and quotients in real arithmetic."""
    if not jnp.iscomplexobj(contrast):
        return fresnel.amplitudes(cosine, contrast)
    cosine = jnp.maximum(cosine, floor_of(cosine) ** 0.5)
    real, imaginary = contrast.real + cosine * cosine, contrast.imag
    larger = jnp.sqrt((jnp.sqrt(real * real + imaginary * imaginary) + jnp.abs(real)) / 2)
    smaller = imaginary / (2 * larger)
    g = lax.complex(jnp.where(real >= 0, larger, smaller), jnp.where(real >= 0, smaller, larger))
    total = _inverse(g + cosine.astype(g.dtype))
    return -contrast * total * total, 2 * contrast * total * _inverse(g + (1 + contrast) * cosine.astype(g.dtype))


def _inverse(z: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    scale = 1 / power(z)
    return lax.complex(z.real * scale, -z.imag * scale)


def _operator(
    model: Polarization,
    shifted: Float[Array, "..."],
    cosine: Float[Array, "..."],
    sine: Float[Array, "..."],
    contrast: Inexact[Array, "..."],
) -> Jones:
    """One reflection at the image under the angle π/2 + shifted.

    For ``"full"``: r_s, κ and the two transverse components of the facet normal; else what multiplies R.
    """
    across = jnp.cos(shifted)
    incidence = cosine * across
    r_s, coupling = _amplitudes(incidence, contrast)
    if model == "full":
        q1 = (-jnp.sin(shifted)).astype(coupling.dtype)
        return r_s, coupling, q1, (-sine * across).astype(coupling.dtype)
    r_p = r_s + coupling * (1 - incidence * incidence).astype(coupling.dtype)
    both = power(r_s), power(r_p)
    return both if model == "separate" else ((both[0] + both[1]) / 2,)


def _after(operator: Jones, state: Jones) -> Jones:
    """A J for a reflection A = r_s I + κ q qᵀ that comes last."""
    r_s, coupling, q1, q2 = operator
    j11, j12, j21, j22 = state
    t1, t2 = coupling * (q1 * j11 + q2 * j21), coupling * (q1 * j12 + q2 * j22)
    return r_s * j11 + q1 * t1, r_s * j12 + q1 * t2, r_s * j21 + q2 * t1, r_s * j22 + q2 * t2


def _before(operator: Jones, state: Jones) -> Jones:
    """J A, the reflection comes first; A is symmetric."""
    j11, j21, j12, j22 = _after(operator, (state[0], state[2], state[1], state[3]))
    return j11, j12, j21, j22


def _reflectance(model: Polarization, state: Jones) -> Float[Array, "..."]:
    if model == "full":
        return sum((power(entry) for entry in state[1:]), start=power(state[0])) / 2
    return (state[0] + state[1]).real / 2 if model == "separate" else state[0].real


def _sum_of_chains(
    model: Polarization,
    most: int | None,
    angle: Array,
    count: Array,
    contrast: Array,
    x: Float[Array, "2 ..."],
    low: Bool[Array, "2 ..."],
    weight: Float[Array, "2 ..."],
    cosine: Float[Array, "..."],
    sine: Float[Array, "..."],
) -> Array:
    """Sum over nodes and numbers of reflections, for M, M - 2, ... and for M - 1, M - 3, ... side by side.

    Args:
        model: treatment of polarization.
        most: return the shares of 1 to ``most`` reflections instead of the sum over all.
        angle: dihedral angle.
        count: M.
        contrast: (n + ik)² - 1.
        x: shifts. The first axis distinguishes M, M - 2, ... from M - 1, M - 3, ...; the next two are nodes, the
            others broadcast with angle and contrast.
        low: whether x lies below the kink, which is where M reflections end and w_{M-1} changes its form.
        weight: of the nodes.
        cosine: cos η.
        sine: sin η.
    """
    half = angle / 2
    classes = jnp.reshape(jnp.asarray([0.0, 1.0], x.dtype), (2, *(1,) * (x.ndim - 1)))
    top = count - classes
    odd = jnp.mod(top, 2)
    shape = jnp.broadcast_shapes(x.shape, cosine.shape, jnp.shape(contrast))
    one = jnp.ones(shape, contrast.dtype if model == "full" else x.dtype)
    empty: Jones = {"full": (one, 0 * one, 0 * one, one), "separate": (one, one), "unpolarized": (one,)}[model]

    def operator(shifted: Array) -> Jones:
        return _operator(model, shifted, cosine, sine, contrast)

    def share(m: Array, state: Jones) -> Array:
        """What chains of m reflections contribute to the sum; nothing for m = 0 or beyond the largest."""
        outer = (m - 1) * half
        ends = jnp.cos(outer + x)
        between = 2 * jnp.sin(outer + half) * jnp.sin(half - x)
        at_top = jnp.where(low, ends, jnp.where(classes == 0, jnp.zeros_like(ends), between))
        w = jnp.where(m == top, at_top, between)
        w = weight * jnp.where((m > 0) & (m <= top), w, jnp.zeros_like(w))
        # Nodes first: their sum is short, and the wavelengths stay side by side.
        share = jnp.sum(w * _reflectance(model, state), axis=(1, 2))
        if most is None:
            return jnp.sum(share, axis=0)
        m = jnp.squeeze(m, (1, 2))
        return jnp.stack(
            [jnp.sum(jnp.where(m == j, share, jnp.zeros_like(share)), axis=0) for j in range(1, most + 1)]
        )

    def body(carry: tuple[Array, Jones, Array]) -> tuple[Array, Jones, Array]:
        step, state, total = carry
        m = odd + 2 * step
        live = (m <= top) & (low | (classes == 1) | (m < top))
        # A dead chain is led through a harmless reflection: its gradient must not meet a 0/0.
        outer = jnp.where(live, (m - 1) * half, jnp.zeros_like(m))
        last, first = operator(x + outer), operator(x - outer)
        if model == "full":
            state = _before(first, _after(last, state))
        else:
            state = tuple(s * a * b for s, a, b in zip(state, last, first, strict=True))
        return step + 1, state, total + share(m, state)

    single = operator(x)
    if model == "full":
        single = _after(single, empty)
    state = tuple(jnp.where(odd == 1, a, e) for a, e in zip(single, empty, strict=True))
    steps = jnp.floor(jnp.max(count, initial=1) / 2)
    if most is not None:
        steps = jnp.minimum(steps, most // 2)
    start = (jnp.ones((), x.dtype), state, share(odd, state))
    total = lax.while_loop(lambda carry: carry[0] <= steps, body, start)[2]
    return total * 4 / (jnp.pi * jnp.sin(half))


def _regular(
    model: Polarization,
    most: int | None,
    resolution: BihemisphericalResolution,
    angle: Array,
    count: Array,
    contrast: Array,
) -> Array:
    """Tensor grid of x and η, refined at grazing incidence, where hard mirrors change fast."""
    rank = max(jnp.ndim(angle), jnp.ndim(contrast))
    trailing = (1,) * rank
    dtype = angle.dtype
    t, weight = unit_legendre(resolution.across)
    up, up_weight = 1 - (1 - t) ** 2, 2 * (1 - t) * weight
    v, along = unit_legendre(resolution.along)
    eta = np.pi / 2 * (1 - v * v)
    along = np.pi * v * along * np.cos(eta) ** 2

    def nodes(values: np.ndarray, axis: int) -> Array:
        return jnp.reshape(
            jnp.asarray(values, dtype), (*(len(values) if i == axis else 1 for i in range(2)), *trailing)
        )

    x1 = count * angle / 2 - jnp.pi / 2
    kink = jnp.stack(jnp.broadcast_arrays(angle / 2 - x1, x1))[:, None, None]
    kink = jnp.reshape(kink, (2, 1, 1, *(1,) * (rank - jnp.ndim(angle)), *jnp.shape(angle)))
    x = jnp.concatenate([kink * nodes(up, 0), kink + (angle / 2 - kink) * nodes(t, 0)], axis=1)
    wx = jnp.concatenate([kink * nodes(up_weight, 0), (angle / 2 - kink) * nodes(weight, 0)], axis=1)
    low = jnp.broadcast_to(jnp.arange(2 * len(t)).reshape(-1, 1, *trailing) < len(t), x.shape)
    cosine, sine = nodes(np.cos(eta), 1), nodes(np.sin(eta), 1)
    return _sum_of_chains(model, most, angle, count, contrast, x, low, wx * nodes(along, 1), cosine, sine)


def critical_cosine(contrast: Inexact[Array, "..."]) -> tuple[Bool[Array, "..."], Float[Array, "..."]]:
    """Where total external reflection begins, and whether it begins there abruptly.

    For n < 1 and k small the amplitudes have their branch point c² = 1 - (n + ik)² close to or on the real range
    of c. How close is |Im arccos| of it: the rate at which polynomials converge.

    Args:
        contrast: (n + ik)² - 1.
    """
    cosine = jnp.sqrt(-contrast.astype(jnp.result_type(contrast, 1j)))
    # |Im arccos c| from the sum of the distances to the foci ±1.
    reach = (jnp.abs(cosine - 1) + jnp.abs(cosine + 1)) / 2
    abrupt = (reach < _ABRUPT) & (contrast.real < 0) & (cosine.real > _GRAZING)
    return abrupt, jnp.clip(cosine.real, _GRAZING, 1)


def _critical(
    model: Polarization,
    most: int | None,
    resolution: BihemisphericalResolution,
    angle: Array,
    count: Array,
    contrast: Array,
) -> tuple[Array, Array]:
    """The same where total external reflection begins abruptly, and for which indices that is so.

    With cos η = c* / cos β, all the reflections that pass the critical cosine c* do so where x is β modulo α or
    its mirror image: one more end of a panel. In β the panels end at the multiples of α/2, and where that
    end crosses the kink.
    """
    rank = max(jnp.ndim(angle), jnp.ndim(contrast))
    trailing = (1,) * rank
    dtype = angle.dtype
    t, weight = unit_legendre(resolution.critical)
    s, ds = t * t * (3 - 2 * t), 6 * t * (1 - t) * weight

    def grid(values: np.ndarray, axis: int) -> Array:
        """Nodes along one of the axes of node arrays (panels of β, nodes of β, panels of x, nodes of x)."""
        return jnp.reshape(
            jnp.asarray(values, dtype), (*(len(values) if i == axis else 1 for i in range(4)), *trailing)
        )

    abrupt, cosine = critical_cosine(contrast)
    abrupt, cosine = (jnp.reshape(a, (*trailing[: rank - jnp.ndim(a)], *a.shape)) for a in (abrupt, cosine))
    half = angle / 2
    x1 = count * half - jnp.pi / 2
    critical = jnp.arccos(cosine)
    wide = critical > 1e-6
    close = float(jnp.finfo(dtype).eps) ** 0.6  # Two ends so close together would be worse than one.
    beta_end = jnp.where(wide, critical, jnp.ones_like(critical))
    panels = jnp.where(abrupt, jnp.where(wide, jnp.ceil(lax.stop_gradient(beta_end / half) - close), 0), -1)
    crossing = jnp.where(jnp.mod(count, 2) == 1, half - x1, x1)

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        panel, total = carry
        beyond = panel < 0
        # Beyond the critical cosine all reflections are total, and the variable is η itself.
        start = jnp.where(beyond, critical, jnp.minimum(panel * half, beta_end))
        end = jnp.where(panel + 1 < panels, (panel + 1) * half, beta_end)
        middle = jnp.clip(panel * half + crossing, start, end)
        middle = jnp.where(end - middle < close, end, middle)
        end = jnp.where(beyond, jnp.pi / 2, end)
        middle = jnp.where(beyond, (start + end) / 2, middle)
        ends = jnp.stack([start, middle, end])
        # With sin β = sin β* sin ψ, the root that the tilt has at its end β* disappears.
        inside = jnp.where(beyond | (ends >= beta_end), jnp.zeros_like(ends), ends)
        psi = jnp.where(ends >= beta_end, jnp.pi / 2, jnp.arcsin(jnp.sin(inside) / jnp.sin(beta_end)))
        ends = jnp.where(beyond, ends, psi)
        lower, upper = ends[:-1, None, None, None], ends[1:, None, None, None]
        v, dv = lower + (upper - lower) * grid(s, 1), (upper - lower) * grid(ds, 1)
        sin_beta = jnp.sin(beta_end) * jnp.sin(v)
        cos_beta = safe_hypot(jnp.cos(beta_end), jnp.sin(beta_end) * jnp.cos(v))
        beta = jnp.where(beyond, jnp.zeros_like(v), jnp.arctan2(sin_beta, cos_beta))
        cos_eta = jnp.where(beyond, jnp.cos(v), jnp.cos(beta_end) / cos_beta)
        sin_eta = jnp.where(beyond, jnp.sin(v), jnp.sin(beta_end) * jnp.cos(v) / cos_beta)
        slope = jnp.where(beyond, jnp.ones_like(v), jnp.cos(beta_end) * sin_beta / cos_beta**2)
        dv = dv * slope * cos_eta**2
        dv = jnp.where(panel < panels, dv, jnp.zeros_like(dv))
        folded = jnp.mod(beta, angle)
        folded = jnp.minimum(folded, angle - folded)

        def of_class(top: Array, kink: Array) -> tuple[Array, Array, Array]:
            """Nodes between 0, the critical shift, the kink and α/2."""
            critical_shift = jnp.where(jnp.mod(top, 2) == 1, folded, half - folded)
            first, second = jnp.minimum(critical_shift, kink), jnp.maximum(critical_shift, kink)
            starts = jnp.concatenate([jnp.zeros_like(first), first, second], axis=2)
            ends = jnp.concatenate([first, second, half + jnp.zeros_like(second)], axis=2)
            low = jnp.concatenate(
                [jnp.ones_like(first, bool), critical_shift < kink, jnp.zeros_like(first, bool)], axis=2
            )
            span = ends - starts
            x = starts + span * grid(s, 3)
            return x, span * grid(ds, 3) * dv, jnp.broadcast_to(low, x.shape)

        x, w, low = (
            jnp.stack(pair) for pair in zip(of_class(count, half - x1), of_class(count - 1, x1), strict=True)
        )
        x, w, low = (jnp.reshape(a, (2, a.shape[1] * a.shape[2], -1, *a.shape[5:])) for a in (x, w, low))
        cos_eta, sin_eta = (jnp.reshape(a, (-1, 1, *a.shape[4:])) for a in (cos_eta, sin_eta))
        return panel + 1, total + _sum_of_chains(model, most, angle, count, calm, x, low, w, cos_eta, sin_eta)

    calm = jnp.where(abrupt, contrast, jnp.ones_like(contrast))
    shape = jnp.broadcast_shapes(jnp.shape(angle), jnp.shape(contrast))
    total = jnp.zeros(shape if most is None else (most, *shape), dtype)
    last = jnp.max(panels, initial=-1)
    return lax.while_loop(lambda carry: carry[0] < last, body, (-jnp.ones((), dtype), total))[1], abrupt


def _evaluate(
    angle: Float[Array, "..."],
    index: Inexact[Array, "..."],
    model: Polarization,
    resolution: BihemisphericalResolution,
    count: Float[Array, "..."] | None,
    most: int | None,
) -> Array:
    def run(count: Array, angle: Array, *parts: Array) -> Array:
        return forward_specular(count, angle, parts, model, resolution, most)

    count = reflections_at_most(angle) if count is None else count
    return elementwise_forward(run, nested=resolution.critical > 0)(count, angle, *index_parts(index))


def index_parts(index: Inexact[Array, "..."]) -> tuple[Array, ...]:
    """What to differentiate by: reflectances are no holomorphic function of a complex index."""
    return (index.real, index.imag) if jnp.iscomplexobj(index) else (index,)


def forward_specular(
    count: Float[Array, "..."],
    angle: Float[Array, "..."],
    parts: tuple[Float[Array, "..."], ...],
    model: Polarization,
    resolution: BihemisphericalResolution,
    most: int | None = None,
) -> Float[Array, "..."]:
    """``specular`` for M = ``count`` and an index in ``index_parts``, differentiable in forward mode only."""
    contrast = permittivity_contrast(parts[0] if len(parts) == 1 else lax.complex(*parts))
    regular = _regular(model, most, resolution, angle, count, contrast)
    if resolution.critical == 0 or len(parts) == 1:
        return regular
    critical, abrupt = _critical(model, most, resolution, angle, count, contrast)
    return jnp.where(abrupt, critical, regular)


def is_tame(index: Inexact[ArrayLike, "..."]) -> np.ndarray:
    """Whether no total external reflection begins abruptly; for a known index."""
    index = np.asarray(index)
    cosine = np.sqrt(1 - index * (index + 0j))
    abrupt = np.abs(cosine - 1) + np.abs(cosine + 1) < 2 * _ABRUPT
    return np.asarray(~(abrupt & ((index * index).real < 1) & (cosine.real > _GRAZING)))


def specular(
    angle: Float[Array, "..."],
    index: Inexact[Array, "..."],
    model: Polarization,
    resolution: BihemisphericalResolution,
    count: Float[Array, "..."] | None = None,
) -> Float[Array, "..."]:
    """Bi-hemispherical reflectance of grooves of one angle, for arguments that broadcast against each other.

    It is continuous in the angle, and so is its slope: at π/k another number of reflections sets in with zero
    weight and zero slope.

    Args:
        angle: dihedral angle, radians, 0 < angle ≤ π.
        index: n + ik; real only if n ≥ 1.
        model: treatment of polarization, see ``Specular``.
        resolution: from ``resolution.bihemispherical_orders``.
        count: M, if not ceil(π/angle): the analytic continuation from the angles with M reflections at most.

    Returns:
        Fraction, of the broadcast shape.
    """
    return _evaluate(angle, index, model, resolution, count, None)


def by_reflections(
    angle: Float[Array, "..."],
    index: Inexact[Array, "..."],
    most: int,
    model: Polarization,
    resolution: BihemisphericalResolution,
) -> Float[Array, "most ..."]:
    """What the rays that are reflected 1, 2, ... ``most`` times contribute [SaintPierre2020, table 4].

    Args:
        angle: dihedral angle, radians, 0 < angle ≤ π.
        index: n + ik; real only if n ≥ 1.
        most: the largest number of reflections that is asked for.
        model: treatment of polarization.
        resolution: from ``resolution.bihemispherical_orders``.

    Returns:
        Fractions, the number of reflections first; their sum over all M is ``specular``.
    """
    return _evaluate(angle, index, model, resolution, None, most)
