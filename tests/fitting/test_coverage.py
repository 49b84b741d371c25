"""How often intervals hold the truth: a seeded sample, and all of the example with 400 replicates (slow)."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "coverage_of_intervals.py"
specification = importlib.util.spec_from_file_location("coverage_of_intervals", EXAMPLE)
coverage = importlib.util.module_from_spec(specification)
specification.loader.exec_module(coverage)

KINK, EDGE = "gold, kink at 90° from the front", "orange, 140°, unknown"
SHALLOW = "gold, roughness 0.05"
"""Nearly flat: a prior that is uniform in the logarithm prefers still less."""
LEVELS = 0.68, 0.95


def kept(found, name, kind, level):
    return coverage.within_chance(*found[name, kind, level], level)


@pytest.mark.parametrize("case", ["gold, 63°, gain and offset", "gold, kink at 90°"])
def test_a_small_sample_covers_at_its_rate(case):
    found = coverage.counted(coverage.cases()[case], 40, seed=3)
    assert all(kept(found, *key) for key in found), found


def test_at_a_frontal_kink_only_the_profile_keeps_its_promise():
    """Known in advance: most of a flat prior's posterior lies on the flat side, 76 to 89 % for 95 %."""
    found = coverage.counted(coverage.cases()[KINK], 60, seed=4)
    assert kept(found, "angle", "profile", 0.95)
    assert not kept(found, "angle", "posterior", 0.68)
    hits, total = found["angle", "posterior", 0.95]
    assert 0.6 < hits / total < 0.95


@pytest.mark.slow
@pytest.mark.parametrize("case", coverage.cases())
def test_intervals_cover_at_their_rate(case):
    """Profiles always, though more often than they say at the edge of what the data determine."""
    found = coverage.counted(coverage.cases()[case], 400, seed=11)
    for name, kind, level in found:
        hits, total = found[name, kind, level]
        assert total == 400 or kind == "standard error"
        if case == EDGE:
            assert kind == "standard error" or hits >= level * total
        elif case not in (KINK, SHALLOW) or kind == "profile":
            assert kept(found, name, kind, level), (name, kind, level, hits, total)
        elif kind == "posterior" and level == 0.95:
            assert 0.7 < hits / total < 0.93
