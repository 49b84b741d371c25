"""Descents that use the arrow shape of the Jacobian: the same as dense ones, monotone, and never trapped."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

import vcavity_jax as vc
from fitting import Measurement, arrow, assembly, free
from fitting.information import local_information
from fitting.parameters import Parameter
from fitting.report import _still

BAND = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
RED = np.array([0.08, 0.12, 0.3, 0.55, 0.7])
GOLD = np.array([1.46 + 1.95j, 0.97 + 1.87j, 0.4 + 2.6j, 0.25 + 2.9j, 0.17 + 3.2j])
FAN = np.radians([0.0, 40.0, 75.0])
LOWEST = np.radians(30.0)
OWN_RED, OWN_GOLD = 0.9 * RED + 0.03, 1.05 * GOLD
"""What the scenes hold: the centers of the priors."""


def scene_of(degrees, material):
    return vc.Scene(vc.VGrooves(np.radians(degrees)), material, vc.Diffuse(), vc.View())


def observe(scene, noise=0.0, sigma=0.005, polar=FAN, seed=0):
    seen = vc.Scene(scene.surface, scene.material, scene.illumination, vc.View(polar, 0 * polar))
    values = np.asarray(vc.reflectance_factor(seen))
    values = values + noise * np.random.default_rng(seed).standard_normal(values.shape)
    return Measurement(BAND, polar, 0 * polar, values, np.full(values.shape, sigma))


def gappy(m, *places):
    """Some values missing, and uncertainties that differ."""
    values = m.reflectance_factor.copy()
    for place in places:
        values[place] = np.nan
    sigma = m.standard_uncertainty * np.linspace(0.5, 2, values.size).reshape(values.shape)
    return Measurement(m.wavelengths_nm, m.polar, m.azimuth, values, sigma)


def built(scene, measurement, parameters, tolerance=1e-8):
    return assembly.build(scene, measurement, parameters, None, tolerance)


def matte(measurement=None, prior=0.2):
    """P = 3 with priors of two, Q = 1."""
    m = observe(scene_of(70, vc.Lambertian(RED)), 0.005) if measurement is None else measurement
    parameters = [
        free.angle(30, 170, prior=(75, 4)),
        free.gain((1.0, 0.02)),
        free.offset(None),
        free.reflectance(prior=prior),
    ]
    return built(scene_of(70, vc.Lambertian(OWN_RED)), m, parameters)


def metal(measurement=None):
    """P = 2 with the logarithm of the angle as coordinate, Q = 2."""
    m = observe(scene_of(83, vc.Specular(GOLD)), 0.005) if measurement is None else measurement
    angle = Parameter("angle", lambda s: s.surface.angle, LOWEST, np.radians(170), scale="log")
    spectrum = free.index_spectrum(complex_valued=True, prior=0.1)
    return built(scene_of(83, vc.Specular(OWN_GOLD)), m, [angle, free.gain((1.0, 0.01)), spectrum])


def matte_point():
    return np.array([np.radians(71.3), 1.01, 0.004]), (1.1 * RED + 0.01)[None]


def metal_point():
    index = 0.97 * GOLD + 0.05j
    return np.array([np.radians(84.4), 1.01]), np.stack([index.real, index.imag])


def dense_residual(kind, values, weights):
    """Weighted residuals and those of the priors, of all unknowns in one vector, written anew."""
    view = vc.View(FAN, 0 * FAN)
    model = functools.partial(vc.reflectance_factor, tolerance=1e-8, smallest_angle=LOWEST)

    def residual(x):
        if kind == "matte":
            scene = vc.Scene(vc.VGrooves(x[0]), vc.Lambertian(x[3:]), vc.Diffuse(), view)
            predicted = x[1] * model(scene) + x[2]
            priors = [(x[0] - np.radians(75)) / np.radians(4), (x[1] - 1) / 0.02]
            spectral = (x[3:] - OWN_RED) / (0.2 * OWN_RED)
        else:
            index = jax.lax.complex(x[2:7], x[7:])
            predicted = x[1] * model(vc.Scene(vc.VGrooves(x[0]), vc.Specular(index), vc.Diffuse(), view))
            priors = [(x[1] - 1) / 0.01]
            parts = (x[2:7] - OWN_GOLD.real, x[7:] - OWN_GOLD.imag)
            spectral = jnp.concatenate([part / (0.1 * np.abs(OWN_GOLD)) for part in parts])
        return jnp.concatenate([((predicted - values) * weights).ravel(), jnp.stack(priors), spectral])

    return residual


@functools.cache
def dense_program(kind):
    def program(x, values, weights):
        residual = dense_residual(kind, values, weights)
        return residual(x), jax.jacfwd(residual)(x)

    return jax.jit(program)


def dense(problem, kind, values, spectra):
    """Residuals and Jacobian at a point."""
    (m,) = problem.measurements
    present = ~np.isnan(m.reflectance_factor)
    weights = np.where(present, 1 / m.standard_uncertainty, 0)
    x = np.concatenate([values, spectra.ravel()])
    return [np.array(a) for a in dense_program(kind)(x, np.where(present, m.reflectance_factor, 0), weights)]


@functools.cache
def step_program(kind):
    return jax.jit(functools.partial(arrow._arrow_step, PROBLEMS[kind](False).layout))


def _matte_problem(missing):
    m = observe(scene_of(70, vc.Lambertian(RED)), 0.005)
    return matte(gappy(m, (1, 2), (0, 0), (slice(None), 3)) if missing else m)


def _metal_problem(missing):
    m = observe(scene_of(83, vc.Specular(GOLD)), 0.005)
    return metal(gappy(m, (1, 2), (0, 0), (slice(None), 3)) if missing else m)


PROBLEMS = {"matte": _matte_problem, "metal": _metal_problem}
POINTS = {"matte": matte_point, "metal": metal_point}
SLOW = pytest.mark.slow
CASES = [
    pytest.param("matte", False, marks=SLOW),
    ("matte", True),
    pytest.param("metal", False, marks=SLOW),
    ("metal", True),
]


@pytest.mark.parametrize(("kind", "missing"), CASES)
def test_information_is_that_of_the_dense_jacobian(kind, missing):
    problem, (values, spectra) = PROBLEMS[kind](missing), POINTS[kind]()
    numbers = len(values)
    residual, jacobian = dense(problem, kind, values, spectra)
    at = _still(problem, values[None], spectra[None])
    assert at.chi_square[0] == pytest.approx(residual @ residual, rel=1e-10)

    square = jacobian.T @ jacobian
    corner, side, block = square[:numbers, :numbers], square[:numbers, numbers:], square[numbers:, numbers:]
    schur = corner - side @ np.linalg.solve(block, side.T)
    normal = problem.normal(at)
    np.testing.assert_allclose(normal.reduced[0], schur, rtol=1e-8, atol=1e-8 * np.abs(schur).min())

    said = local_information(normal)
    covariance = np.linalg.inv(square)
    np.testing.assert_allclose(said.covariance, covariance[:numbers, :numbers], rtol=1e-8)
    errors = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(said.standard_errors, errors[:numbers], rtol=1e-8)
    np.testing.assert_allclose(said.spectral_errors.ravel(), errors[numbers:], rtol=1e-8)
    np.testing.assert_allclose(
        said.correlation, covariance[:numbers, :numbers] / np.outer(errors[:numbers], errors[:numbers]), rtol=1e-8
    )

    basis = np.linalg.qr(jacobian[:, numbers:])[0]
    columns = jacobian[:, :numbers] - basis @ (basis.T @ jacobian[:, :numbers])
    scaled = columns / np.linalg.norm(jacobian[:, :numbers], axis=0)
    shares = np.linalg.svd(scaled, compute_uv=False)
    np.testing.assert_allclose(said.singular_values, shares, rtol=1e-8)
    assert 0.01 < shares[-1] < 0.99
    assert not said.singular
    assert said.determined.all()


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize(("kind", "missing"), CASES)
def test_a_step_is_that_of_the_dense_system(kind, missing, damping):
    """Marquardt's: the diagonal grows by its own share. All may move, or some are held."""
    problem, (values, spectra) = PROBLEMS[kind](missing), POINTS[kind]()
    numbers = len(values)
    residual, jacobian = dense(problem, kind, values, spectra)
    if kind == "metal":
        jacobian[:, 0] *= values[0]  # The coordinate is the logarithm of the angle.
    at = _still(problem, values[None], spectra[None])
    natural = problem.natural(values[None])[0]
    for held in ([], [1], [0, numbers + 2]):
        moves = ~np.isin(np.arange(jacobian.shape[1]), held)
        square, slope = jacobian[:, moves].T @ jacobian[:, moves], jacobian[:, moves].T @ residual
        wanted = np.zeros(len(moves))
        wanted[moves] = -np.linalg.solve(square + damping * np.diag(np.diag(square)), slope)
        step, spectral = step_program(kind)(
            at.matrix[0],
            natural,
            jnp.asarray(damping),
            moves[:numbers],
            moves[numbers:].reshape(spectra.shape),
            problem.data,
        )
        found = np.concatenate([np.asarray(step), np.asarray(spectral).ravel()])
        np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())


def test_a_wavelength_without_values_is_as_if_it_were_not_there():
    whole = observe(scene_of(70, vc.Lambertian(RED)), 0.005)
    m = gappy(whole, (slice(None), 3))
    problem = matte(m, prior=None)
    values, spectra = matte_point()
    said = local_information(problem.normal(_still(problem, values[None], spectra[None])))
    assert said.determined.tolist() == [True, True, True, False, True]
    assert np.isnan(said.spectral_errors[0, 3])
    rest = np.delete(np.arange(8), 6)
    jacobian = dense(problem, "matte", values, spectra)[1][:-5, rest]
    errors = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    np.testing.assert_allclose(said.standard_errors, errors[:3], rtol=1e-8)
    np.testing.assert_allclose(np.delete(said.spectral_errors[0], 3), errors[3:], rtol=1e-8)
    assert problem.degrees_of_freedom == 12 + 2 - 7


@pytest.mark.parametrize("kind", ["matte", "metal"])
def test_no_descent_ends_higher_than_it_started(kind):
    """Nor outside the bounds. From far away, where many steps fail."""
    problem = PROBLEMS[kind](False)
    low, high = problem.data.bounds
    random = np.random.default_rng(3)
    count, (values, spectra) = 24, POINTS[kind]()
    starts = np.repeat(values[None], count, axis=0)
    starts[:, 0] = np.exp(random.uniform(np.log(LOWEST), np.log(np.radians(170)), count))
    starts[:, 1] = random.uniform(0.5, 2, count)
    bottom, top = np.asarray(problem.data.spectral_bounds)
    shares = random.uniform(0.001, 0.999, (count, *spectra.shape))
    chosen = bottom[:, None] + (np.minimum(top, 4.0) - bottom)[:, None] * shares
    before = problem.descend(starts, chosen, np.zeros(starts.shape, bool), np.zeros(chosen.shape, bool), outer=0)
    for inner in (0, 8):
        ends = problem.descend(starts, chosen, inner=inner, outer=40)
        assert np.isfinite(before.chi_square).all()
        assert (ends.chi_square <= before.chi_square).all()
        assert np.median(ends.chi_square / before.chi_square) < 1e-2
        assert ends.rejected.sum() > 0
        natural = problem.natural(ends.values)
        assert (natural >= np.asarray(low)).all()
        assert (natural <= np.asarray(high)).all()
        assert (ends.spectra >= bottom[:, None]).all()
        assert (ends.spectra <= top[:, None]).all()
        # The cost that a descent says it reached is the cost of the place it says it reached.
        again = _still(problem, ends.values, ends.spectra)
        np.testing.assert_allclose(again.chi_square, ends.chi_square, rtol=1e-9, atol=1e-9)


def test_a_minimum_beyond_bounds_ends_on_them():
    """The true angle lies above its upper bound, and a reflectance; the rest is minimized as well as it can be."""
    scene = scene_of(70, vc.Lambertian(RED))
    m = observe(scene)
    parameters = [free.angle(30, 60), free.gain((1.0, 0.02)), free.offset(None), free.reflectance(upper=0.65)]
    problem = built(scene, m, parameters)
    starts = np.array([[35, 1, 0], [55, 1.2, 0], [60, 0.9, 0.01], [45, 1, -0.01]])
    starts[:, 0] = np.radians(starts[:, 0])
    ends = problem.descend(starts, np.repeat(0.5 * RED[None, None], 4, axis=0))
    assert (ends.status == arrow.CONVERGED).all()
    assert (ends.values[:, 0] == np.radians(60)).all()
    at_top, at_bottom = ends.spectra[:, 0] == 0.65, ends.spectra[:, 0] == 0
    assert (at_top == [False, False, False, False, True]).all()
    assert (at_bottom == [True, False, False, False, False]).all()
    # Where Lagrange's multipliers have the right sign and all other slopes vanish, there is a minimum.
    lengths = np.sqrt(np.einsum("nbii->nbi", ends.matrix))
    slope = ends.matrix[..., -1].sum(axis=1) / np.sqrt(np.sum(lengths**2, axis=1))
    prior = (ends.values[:, 1] - 1) / 0.02**2 / np.sqrt(np.sum(lengths**2, axis=1))[:, 1]
    assert (slope[:, 0] < -0.1).all()
    assert np.abs(slope[:, 1] + prior).max() < 1e-4
    assert np.abs(slope[:, 2]).max() < 1e-4
    own = ends.matrix[:, :, 3, -1] / lengths[:, :, 3]
    assert (own[at_top] < -0.1).all()
    assert (own[at_bottom] > 0.1).all()
    assert np.abs(own[~at_top & ~at_bottom]).max() < 1e-4
    assert np.ptp(ends.chi_square) < 1e-6 * ends.chi_square[0]


@pytest.mark.parametrize("kind", ["matte", "metal"])
def test_a_start_without_a_number_says_so_and_harms_no_other(kind):
    problem = PROBLEMS[kind](False)
    values, spectra = POINTS[kind]()
    starts = np.repeat(values[None], 5, axis=0)
    starts[:, 0] *= np.linspace(0.8, 1.2, 5)
    both = np.repeat(spectra[None], 5, axis=0)
    alone = problem.descend(starts, both, inner=5)
    for place in ("number", "spectrum"):
        bad_starts, bad_spectra = np.insert(starts, 2, starts[2], axis=0), np.insert(both, 2, both[2], axis=0)
        if place == "number":
            bad_starts[2, 1] = np.nan
        else:
            bad_spectra[2, 0, 1] = np.nan
        together = problem.descend(bad_starts, bad_spectra, inner=5)
        assert arrow.STATUS_WORDS[together.status[2]] == "no number"
        assert not np.isfinite(together.chi_square[2])
        assert not together.converged[2]
        others = np.delete(np.arange(6), 2)
        assert (together.status[others] == arrow.CONVERGED).all()
        np.testing.assert_allclose(together.values[others], alone.values, rtol=1e-12)
        np.testing.assert_allclose(together.chi_square[others], alone.chi_square, rtol=1e-12)
        assert together.steps[others].tolist() == alone.steps.tolist()


def on_a_kink(problem_of, kink, wanted, seed):
    """Replicates whose chi-square has a minimum in the kink, not beside it, and their minimum."""
    random = np.random.default_rng(seed)
    beside = kink + np.radians([-0.01, -0.001, 0.0, 0.001, 0.01])
    found = []
    for _ in range(60 * wanted):
        problem = problem_of(random)
        cost = problem.evaluate(beside[:, None]).chi_square
        if np.argmin(cost) == 2 and cost[0] > cost[1] and cost[4] > cost[3]:
            found.append((problem, cost[2], kink + np.radians(random.uniform(-6, 6))))
            if len(found) == wanted:
                return found
    raise AssertionError(f"only {len(found)} replicates with a minimum in the kink")


@pytest.mark.parametrize("truth_deg", [90.0, 60.0])
def test_a_kink_does_not_trap(truth_deg):
    """20 replicates of gold seen from the front, whose slope falls tenfold below 90 degrees.

    The gradient does not vanish there; Gauss-Newton without damping jumps from side to side for ever.
    """
    scene = scene_of(truth_deg, vc.Specular(GOLD))
    clean = observe(scene, polar=np.zeros(1))

    def replicate(random):
        values = clean.reflectance_factor + 0.005 * random.standard_normal(clean.reflectance_factor.shape)
        noisy = Measurement(BAND, clean.polar, clean.azimuth, values, clean.standard_uncertainty)
        return built(scene, noisy, [free.angle(30, 170)])

    for problem, lowest, start in on_a_kink(replicate, np.radians(truth_deg), 20, seed=int(truth_deg)):
        end = problem.descend(np.array([[start]]), np.zeros((1, 0, 1)))
        assert end.status[0] == arrow.CONVERGED
        assert end.chi_square[0] - lowest < 0.02, np.degrees(start)
        assert np.degrees(end.values[0, 0]) == pytest.approx(truth_deg, abs=0.02)


def all_arrays(jaxpr):
    """Every array of a program, also within loops and branches."""
    for variable in (*jaxpr.invars, *jaxpr.constvars):
        yield variable.aval
    for equation in jaxpr.eqns:
        for variable in equation.outvars:
            yield variable.aval
        for inner in jaxprs_in_params(equation.params):
            yield from all_arrays(inner)


@pytest.mark.parametrize("kind", ["matte", "metal"])
def test_work_grows_in_proportion_to_the_wavelengths(kind):
    """A dense Jacobian would have an axis of unknowns beside that of wavelengths, and U² numbers."""
    largest = {}
    for count in (101, 307):  # Primes: no other axis is as long, and no product of axes looks like one.
        nm = np.linspace(400, 700, count)
        if kind == "matte":
            material = vc.Lambertian(np.full(count, 0.4))
            parameters = [free.angle(30, 170), free.gain(), free.reflectance()]
        else:
            material = vc.Specular(np.full(count, 0.3 + 3j))
            parameters = [free.angle(30, 170), free.gain(), free.index_spectrum(complex_valued=True)]
        values = np.full((3, count), 0.4)
        m = Measurement(nm, FAN, 0 * FAN, values, 0.01 + 0 * values)
        problem = built(scene_of(80, material), m, parameters)
        free_spectra = problem.layout.free_spectra
        program = jax.make_jaxpr(
            lambda n, s, problem=problem: arrow.linearized(problem.layout, n, s, problem.data)
        )(np.array([1.4, 1.0]), np.full((free_spectra, count), 0.5))
        arrays = list(all_arrays(program.jaxpr))
        assert len(arrays) > 100
        assert max(sum(size % count == 0 and size > 0 for size in a.shape) for a in arrays) == 1
        largest[count] = max(np.prod(a.shape, dtype=int) for a in arrays)
    assert largest[307] / largest[101] == pytest.approx(307 / 101, rel=0.02)
