"""The reduction, and shares whose answers are known."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from ldctoolkit import metrics
from ldctoolkit.errors import InputError

FloatArray = npt.NDArray[np.float64]
NAN = math.nan


def test_reduction() -> None:
    S, S_uncorrected = np.array([0.25, 1.5, 0.0, 0.3, NAN]), np.array([1.0, 1.0, 0.0, 0.0, NAN])
    np.testing.assert_array_equal(metrics.reduction(S, S_uncorrected), [0.75, -0.5, 0.0, 0.0, NAN])


def test_shares_of_all_and_of_the_interventions() -> None:
    triggered = np.array([True, True, True, False])
    assert metrics.share_within_dtle([-0.3, -0.31, 0.2, -0.1]) == 0.75
    assert metrics.share_within_dtle([-0.3, -0.31, 0.2, -0.1], limit=-0.2) == 0.5
    assert metrics.share_deeper(np.array([0.5, 0.51, 0.1, 0.9]), 0.5) == 0.5
    peaks, jerks = [3.0, 3.1, 1.0, 9.0], [5.0, 1.0, 5.1, 9.0]
    np.testing.assert_array_equal(metrics.comfortable(peaks, jerks), [True, False, False, False])
    # the last one did not intervene: neither counted nor in the denominator
    assert metrics.comfortable_share(peaks, jerks, triggered) == pytest.approx(1 / 3)
    assert metrics.comfortable_share([1.0] * 4, [1.0] * 4, triggered) == 1.0
    np.testing.assert_array_equal(metrics.needless(triggered, [0.3, 0.31, 0.2, 0.1]), [True, False, True, False])
    assert metrics.needless_share(triggered, [0.3, 0.31, 0.2, 0.1]) == 0.5
    assert metrics.needless_share(triggered, [0.3, 0.31, 0.2, 0.1], limit=-0.2) == 0.25
    assert metrics.back_inside_share([2.0, np.inf, np.inf, 3.0], triggered) == pytest.approx(1 / 3)
    assert metrics.opposite_crossed_share([0.0, 0.1, 1e-9, 0.4], triggered) == pytest.approx(2 / 3)


def test_shares_of_many_designs_are_those_of_each() -> None:
    rng = np.random.default_rng(8)
    d, n = 5, 40
    triggered = rng.random((d, n)) < 0.4
    triggered[2] = False
    depth, peak, jerk = rng.random(n), 6 * rng.random((d, n)), 10 * rng.random((d, n))
    dtle, over = rng.normal(size=(d, n)), np.maximum(0, rng.normal(size=(d, n)))
    back = np.where(rng.random((d, n)) < 0.5, 2.0, np.inf)

    def shares(rows: int | slice) -> list[float | FloatArray]:
        return [
            metrics.share_within_dtle(dtle[rows]), metrics.comfortable_share(peak[rows], jerk[rows], triggered[rows]),
            metrics.needless_share(triggered[rows], depth), metrics.back_inside_share(back[rows], triggered[rows]),
            metrics.opposite_crossed_share(over[rows], triggered[rows]),
        ]  # fmt: skip

    together = shares(slice(None))
    for i in range(d):
        one = shares(i)
        assert all(type(share) is float for share in one)
        np.testing.assert_array_equal([np.asarray(share)[i] for share in together], one)
    assert np.isnan(np.asarray(together[1])).tolist() == [False, False, True, False, False]


def test_empty_sets() -> None:
    nobody = np.zeros(0, dtype=bool)
    assert metrics.share_within_dtle([]) == 0.0
    assert metrics.share_deeper(np.zeros(0), 0.5) == 0.0
    assert metrics.needless_share(nobody, []) == 0.0
    # no intervention: a share of nothing
    for triggered in (nobody, np.zeros(3, dtype=bool)):
        values = np.zeros(triggered.size)
        assert math.isnan(metrics.comfortable_share(values, values, triggered))
        assert math.isnan(metrics.back_inside_share(values, triggered))
        assert math.isnan(metrics.opposite_crossed_share(values, triggered))


def test_a_nan_counts_and_is_seen() -> None:
    values, yes = [0.1, NAN, 0.2], np.array([True, True, True])
    no = np.array([True, False, True])
    assert math.isnan(metrics.share_within_dtle(values))
    assert math.isnan(metrics.share_deeper(np.array(values), 0.5))
    assert not metrics.comfortable(values, [0.0] * 3)[1]
    for share in (
        lambda flags: metrics.comfortable_share([0.0] * 3, values, flags),
        lambda flags: metrics.comfortable_share(values, [0.0] * 3, flags),
        lambda flags: metrics.back_inside_share(values, flags),
        lambda flags: metrics.opposite_crossed_share(values, flags),
        lambda flags: metrics.needless_share(flags, values),
    ):
        assert math.isnan(share(yes))
        assert not math.isnan(share(no))  # not an intervention, so not asked for


# ---------------------------------------------------------------- bad input

Z3 = np.zeros(3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: metrics.back_inside_share([0.1, 0.0], [1.0, 0.0]),
            "triggered: an array of float64; allowed: booleans",
        ),
        (lambda: metrics.back_inside_share(0.1, True), r"t_back \(\), triggered \(\); allowed: \(n,\) or \(d, n\)"),
        (lambda: metrics.needless_share([True, False], [0.1]), r"d_y \(1,\), triggered \(2,\)"),
        (lambda: metrics.needless([True], [0.1], NAN), "limit: nan; allowed: a number"),
        (lambda: metrics.share_within_dtle([0.1], limit="deep"), "limit: 'deep'"),  # type: ignore[arg-type]
        (lambda: metrics.share_within_dtle(["a"]), "dtle: not an array of numbers"),
        (lambda: metrics.share_deeper(np.zeros((2, 2)), 0.5), r"deepest: shape \(2, 2\)"),
        (lambda: metrics.comfortable(Z3, Z3, a_y_limit=NAN), "a_y_limit: nan"),
    ],
)
def test_bad_input(call: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()  # type: ignore[operator]
