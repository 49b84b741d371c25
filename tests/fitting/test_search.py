"""Grids, distinct minima and sections, on functions whose answers are known."""

import numpy as np
import pytest

from fitting import free, search


def test_angle_axis_covers_the_range_and_every_kink():
    kinks = np.radians([45.03, 60.0, 90.0])
    axis = search.axis(free.angle(10, 170), kinks)
    assert axis[0] == np.radians(10)
    assert axis[-1] == np.radians(170)
    assert np.all(np.diff(axis) > 0)
    assert np.max(np.diff(axis)) <= np.radians(0.2) * (1 + 1e-9)
    for kink in kinks:
        for wanted in (kink - search.KINK_MARGIN, kink, kink + search.KINK_MARGIN):
            assert np.min(np.abs(axis - wanted)) < 1e-9


def test_roughness_axis_is_even_in_the_logarithm():
    axis = search.axis(free.roughness(0.01, 3.0), np.empty(0))
    steps = np.diff(np.log(axis))
    assert np.ptp(steps) < 1e-9
    assert 0.025 < steps[0] <= 0.03


def test_product_axes_end_on_the_bounds():
    parameters = [free.angle(10, 120), free.parameter("r", lambda s: s, 0.2, 0.8)]
    angle, other = search.product_axes(parameters)
    assert (angle[0], angle[-1]) == (parameters[0].lower, parameters[0].upper)
    assert (other[0], other[-1]) == (0.2, 0.8)


def test_prominence_tells_minima_from_ripples():
    cost = np.array([5.0, 1.0, 3.0, 2.95, 4.0, 0.0, 7.0, 6.0])
    places, depth = search.prominences(cost)
    assert places.tolist() == [1, 3, 5, 7]
    assert depth == pytest.approx([3.0, 0.05, np.inf, 1.0])
    assert search.distinct_minima(cost, 5).tolist() == [5, 1, 7]
    assert search.distinct_minima(cost, 2).tolist() == [5, 1]


def test_a_plateau_is_one_minimum():
    places, _ = search.prominences(np.array([3.0, 1.0, 1.0, 1.0, 2.0]))
    assert places.tolist() == [1]


def test_product_minima_see_diagonal_neighbors():
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21), indexing="ij")
    # A narrow diagonal valley has one minimum, though neighbors along the axes all lie higher in it.
    valley = 100 * (x - y) ** 2 + (x + y - 0.4) ** 2
    assert search.product_minima(valley, 8) == [(12, 12)]


def test_section_minima_reach_cusps_and_parabolas():
    def cost(x):
        return np.where(x < 2, np.abs(x - 0.3) ** 0.5, (x - 3.7) ** 2)

    places, costs = search.section_minima(cost, np.array([[0.0, 1.0], [3.0, 4.5]]), 1e-9, 12)
    assert places == pytest.approx([0.3, 3.7], abs=1e-7)
    assert costs == pytest.approx([0, 0], abs=1e-4)


def test_section_roots_end_where_the_region_ends():
    roots = search.section_roots(lambda x: x**2 < 2, np.array([[0.0, 3.0], [-1.0, -1.9]]), 1e-10, 8)
    assert roots == pytest.approx([2**0.5, -(2**0.5)], abs=1e-9)
    assert len(search.section_roots(lambda x: x > 0, np.empty((0, 2)), 1e-3, 8)) == 0
