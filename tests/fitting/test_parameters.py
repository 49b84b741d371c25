"""Parameters: bounds, transforms, ready-made ones, and refusals in one clear line."""

import math
import subprocess
import sys

import numpy as np
import pytest

import fitting
from fitting import free
from fitting.parameters import Parameter
from fitting.priors import LogNormal, Normal, TruncatedNormal, Uniform


@pytest.mark.parametrize("parameter", [free.angle(), free.roughness(), free.parameter("r", lambda s: s, 0.1, 0.9)])
def test_natural_coordinates_are_inverse(parameter):
    values = np.linspace(parameter.lower, parameter.upper, 23)
    assert np.allclose(parameter.from_natural(parameter.natural(values)), values, rtol=1e-14)
    beyond = parameter.from_natural(np.array([-800.0, 800.0]))
    assert beyond[0] == parameter.lower
    assert beyond[1] == parameter.upper


def test_angles_are_radians_inside_and_degrees_on_paper():
    angle = free.angle(10, 170, prior=(45, 2))
    assert angle.lower == math.radians(10)
    assert angle.displayed(angle.upper) == pytest.approx(170)
    assert angle.prior.mean == pytest.approx(math.radians(45))
    assert angle.prior.standard_deviation == pytest.approx(math.radians(2))


def test_default_priors_of_the_instrument():
    assert free.gain().prior == Normal(1.0, 0.01)
    assert free.offset().prior == Normal(0.0, 0.002)
    assert free.gain(None).prior is None
    assert free.angle().prior is None


def test_priors_narrow_bounds_and_pull():
    within = free.angle(10, 170, prior=Uniform(30, 60))
    assert (within.lower, within.upper) == pytest.approx((math.radians(30), math.radians(60)))
    assert within.gaussian is None
    cut = free.roughness(prior=TruncatedNormal(0.4, 0.1, 0.2, 0.8))
    assert (cut.lower, cut.upper, cut.gaussian) == (0.2, 0.8, (0.4, 0.1, False))
    decades = free.roughness(prior=LogNormal(0.3, 0.5))
    assert (decades.lower, decades.gaussian) == (0.01, (math.log(0.3), 0.5, True))
    assert free.gain(LogNormal(2.0, 0.1)).start == pytest.approx(2.0)
    assert free.gain(LogNormal(2.0, 0.1)).lower == 0


def test_what_has_a_start_is_not_searched():
    assert free.angle().searched
    assert not free.parameter("r", lambda s: s, 0.1, 0.9, start=0.3).searched
    assert not any(p.searched for p in (free.gain(), *free.tilt(), free.stray_light(), free.wavelength_shift()))
    assert free.parameter("r", lambda s: s, 0.1, 0.9, start=2.0).start == 0.9


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: free.angle(60, 60), "expected 0 < lower < upper"),
        (lambda: free.angle(0, 60), "expected 0 < lower < upper"),
        (lambda: free.angle(10, 190), "expected 0 < lower < upper"),
        (lambda: free.roughness(0.0, 1.0), "expected a positive number"),
        (lambda: free.roughness(2.0, 1.0), "expected lower < upper"),
        (lambda: free.parameter("r", lambda s: s, 0.5, 0.5), "expected lower < upper"),
        (lambda: free.parameter("r", lambda s: s, 0.5, math.nan), "expected lower < upper"),
        (lambda: free.parameter("r", lambda s: s, 0.5, math.inf), "expected finite bounds"),
        (lambda: free.gain((1.0, 0.0)), "positive standard deviation"),
        (lambda: free.parameter("r", lambda s: s, 0, 1, prior=(0.5, -1.0)), "positive standard deviation"),
        (lambda: free.parameter("r", lambda s: s, 0, 1, prior=0.3), "expected .mean, standard deviation."),
        (lambda: LogNormal(-1.0, 0.1), "expected a positive median"),
        (lambda: Uniform(1.0, 1.0), "expected lower < upper"),
        (lambda: TruncatedNormal(0.0, 1.0, 2.0, 1.0), "expected lower < upper"),
        (lambda: free.angle(20, 40, prior=Uniform(50, 60)), "expected lower < upper"),
        (lambda: free.reflectance(upper=1.2), "0 ≤ lower < upper ≤ 1"),
        (lambda: free.reflectance(smooth_nm=0), "expected a positive number"),
        (lambda: free.reflectance(prior=-0.1), "expected a positive share"),
        (lambda: free.reflectance(prior=0.1, smooth_nm=40), "expected one of prior and form"),
        (lambda: free.index_spectrum(complex_valued=True, lower=(1, 1), upper=(1, 2)), "lower < upper"),
        (lambda: free.Cauchy(1.5, 0.0), "no coefficient is a range"),
        (lambda: free.Cauchy((1.6, 1.5)), "expected a number, or a range"),
        (lambda: free.Sellmeier([(1, 2)], []), "expected one per term"),
        (lambda: free.tilt(limit_deg=40), "up to 30 degrees"),
        (lambda: free.stray_light(1.0), "above 0, below 1"),
        (lambda: free.wavelength_shift(0), "expected a positive limit"),
        (lambda: free.parameter("r", lambda s: s, 0, 1, start=math.nan), "expected a finite number"),
        (lambda: Parameter("", None, 0.0, 1.0), "expected some text"),
        (lambda: Parameter("a", None, 0.0, 1.0, unit="deg"), "expected 'rad', 'nm' or '1'"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(ValueError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_importing_fitting_does_not_import_jax():
    code = "import sys, fitting; print('jax' in sys.modules, sorted(fitting.__all__) == dir(fitting))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.split() == ["False", "True"]


def test_public_names_resolve():
    assert all(getattr(fitting, name) is not None for name in fitting.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = fitting.nothing
