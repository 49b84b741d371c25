"""False alarms and power of the tests for structured residuals."""

import numpy as np
import pytest

import vcavity_jax as vc
from fitting import Measurement, fit, free, residual_structure
from fitting.residuals import ALARM, structure_of

RANDOM = np.random.default_rng(0)
NORMAL = RANDOM.standard_normal((4000, 3, 31))
HEAVY = RANDOM.standard_t(2, NORMAL.shape)
UNEVEN = NORMAL * np.geomspace(0.1, 10, 31)
DRIFT = 3 * np.sin(np.linspace(0, 3, 31)) - 1.8


def alarms(noise, together=False):
    return sum(structure_of([one], together).structured for one in noise)


@pytest.mark.parametrize(
    "noise", [NORMAL, HEAVY, UNEVEN, NORMAL[:, :1]], ids=["normal", "heavy", "uneven", "one view"]
)
def test_noise_is_called_structured_once_in_a_thousand(noise):
    assert alarms(noise) <= 10  # One in a thousand is 4; three binomial errors above.


def test_directions_that_a_free_spectrum_ties_together():
    """Each wavelength loses one combination of its directions: not a coin for each direction any more."""
    direction = np.array([0.2, 0.5, 0.85])
    direction /= np.linalg.norm(direction)
    left = NORMAL - direction[:, None] * np.einsum("d,ndl->nl", direction, NORMAL)[:, None]
    assert alarms(left, together=True) <= 10


def test_drifts_are_found():
    found = structure_of([DRIFT + NORMAL[0]])
    assert found.structured
    assert "neighboring wavelengths go together" in found.sentence()
    assert (found.alike, found.pairs) == (60, 90)
    assert structure_of([2 * DRIFT + NORMAL[0]], together=True).structured
    gap = DRIFT + NORMAL[1]
    gap[1, 3:6] = np.nan
    found = structure_of([gap])
    assert found.structured
    assert found.pairs == 86


def test_an_outlier_hides_nothing():
    """The signs tell what one huge residual would drown."""
    spoiled = np.sign(DRIFT) * np.ones((3, 31)) + 0.1 * NORMAL[2]
    spoiled[0, 10], spoiled[0, 11] = 1e4, -1e4
    assert structure_of([spoiled]).structured


def test_several_grids_count_together():
    weak = [0.8 * DRIFT + n for n in NORMAL[:4]]
    each = [structure_of([one]).probability for one in weak]
    assert structure_of(weak).probability < min(each)


def test_nothing_to_test():
    assert structure_of([NORMAL[0][:, :1]]) is None
    assert structure_of([np.full((2, 4), np.nan)]) is None


def test_a_few_neighbors_raise_no_alarm():
    """Ten pairs with the same sign happen by chance once in a thousand, and there are two tests."""
    assert structure_of([np.ones((1, 11))]).probability > ALARM / 2
    assert structure_of([np.ones((1, 14))]).structured


def test_of_a_fit():
    """A wrong index table leaves the shape of the spectrum; rounding and noise leave nothing."""
    nm = np.arange(400.0, 701.0, 10.0)
    polar = np.radians([0.0, 50.0])
    gold, copper = (vc.materials.refractive_index(key, nm) for key in ("Au-Johnson", "Cu-Johnson"))

    def grooves(index):
        return vc.Scene(vc.VGrooves(np.radians(70.0)), vc.Specular(index), vc.Diffuse(), vc.View(polar, 0 * polar))

    exact = np.asarray(vc.reflectance_factor(grooves(gold)))

    def structure(values, index):
        measured = Measurement(nm, polar, 0 * polar, values, np.full(exact.shape, 0.005))
        return residual_structure(fit(grooves(index), measured, [free.angle(40, 120)]))

    assert structure(np.round(exact, 5), gold) is None
    noisy = exact + 0.005 * np.random.default_rng(3).standard_normal(exact.shape)
    assert not structure(noisy, gold).structured
    assert structure(noisy, copper).structured
