"""Parameters: bounds, transforms, ready-made ones, and refusals in one clear line."""

import math
import subprocess
import sys

import numpy as np
import pytest

import fitting
from fitting import free
from fitting.parameters import Parameter


@pytest.mark.parametrize("parameter", [free.angle(), free.roughness(), free.parameter("r", lambda s: s, 0.1, 0.9)])
def test_transforms_are_inverse(parameter):
    values = np.linspace(parameter.lower, parameter.upper, 23)
    inside = values[1:-1]
    assert np.allclose(parameter.from_unconstrained(parameter.unconstrained(inside)), inside, rtol=1e-12)
    assert np.allclose(parameter.from_natural(parameter.natural(values)), values, rtol=1e-14)
    beyond = parameter.from_unconstrained(np.array([-800.0, 800.0]))
    assert beyond[0] == parameter.lower
    assert beyond[1] == parameter.upper


def test_a_bound_is_moved_inside_by_a_millionth():
    angle = free.angle(20, 120)
    place = np.degrees(angle.from_unconstrained(angle.unconstrained(angle.upper)))
    assert place == pytest.approx(120 - 1e-4, abs=1e-9)


def test_angles_are_radians_inside_and_degrees_on_paper():
    angle = free.angle(10, 170, prior=(45, 2))
    assert angle.lower == math.radians(10)
    assert angle.displayed(angle.upper) == pytest.approx(170)
    assert angle.prior == pytest.approx((math.radians(45), math.radians(2)))


def test_default_priors_of_the_instrument():
    assert free.gain().prior == (1.0, 0.01)
    assert free.offset().prior == (0.0, 0.002)
    assert free.gain(None).prior is None
    assert free.angle().prior is None


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
        (lambda: Parameter("", None, 0.0, 1.0), "expected some text"),
        (lambda: Parameter("a", None, 0.0, 1.0, unit="deg"), "expected 'rad' or '1'"),
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
