"""S within 5e-6 m s and every metric within 1e-4 of the independent closed loop, tyres up to and beyond their peak.

S is absolute. A metric's difference is relative to the larger of 1 (in SI units) and its value: one of lateral
acceleration or jerk may be large, the others are absolute. The hard region is counted, so that it is not left by
accident: a slip beyond the peak of the Magic Formula's force, at a sample."""

import numpy as np
import pytest

from helpers import accuracy, reference_loop
from helpers.accuracy import CASES, NAMES

S_BOUND, METRIC_BOUND = 5e-6, 1e-4
HARD_SHARE = {"tyres": 0.5, "tyres, mu 0.3": 0.8, "tyres, profile, actuator": 0.4, "all": 0.2}
"""Of the departures that are compared, at least so many go beyond the peak."""

QUICK = {"tyres": (1, 8), "tyres, mu 0.3": (1, 8), "tyres, profile, actuator": (1,), "all": (1,)}  # beyond the peak


def compare(case: str, rows: np.ndarray, share: float = 1.0) -> tuple[int, int]:
    """Compare departures of a case, of which this share keeps the bounds; how many were compared, how many of them went
    beyond the peak.
    """
    scenarios = accuracy.departures(case, int(rows.max()) + 1).take(rows)
    laws = accuracy.prepared(case, scenarios)
    found = [
        accuracy.expected(case, scenarios, i, reference_loop.of_row(*laws[i]) if i in laws else None)
        for i in range(scenarios.n)
    ]
    values, diverged = accuracy.driven(case, scenarios)
    lost = np.array([one.lost for one in found])
    np.testing.assert_array_equal(diverged, lost)
    apart = accuracy.differences(values, np.array([one.values for one in found]))[~lost]
    bounds = np.array([S_BOUND, *[METRIC_BOUND] * len(NAMES)])
    beyond = [
        f"row {rows[~lost][i]}: {('S', *NAMES)[j]} is {apart[i, j]:.1e} apart"
        for i, j in np.argwhere(~(apart <= bounds))
    ]
    outside = int((~(apart <= bounds)).any(axis=1).sum())
    assert outside <= (1.0 - share) * len(apart), "\n".join(beyond)
    assert case == "camera" or bool((apart <= 10.0 * bounds).all()), "\n".join(beyond)
    return len(apart), sum(one.slip > 1.0 for one in found if not one.lost)


@pytest.mark.parametrize("case", CASES)
def test_s_and_peaks_equal_the_reference(case: str) -> None:
    compared, beyond = compare(case, np.array(QUICK.get(case, (5,))))
    assert compared > 0
    assert beyond > 0 or case not in QUICK


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_s_and_peaks_of_forty_departures_equal_the_reference(case: str) -> None:
    # frames between samples that no filter smooths: the loop enlarges what differs
    compared, beyond = compare(case, np.arange(40), 0.8 if case == "camera" else 0.94)
    assert compared >= 30
    assert beyond >= HARD_SHARE.get(case, 0.0) * compared
