"""The bad end of S against the definition of the conditional value at risk, and figures over marked columns."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.ranking.design_metrics import masked_max, masked_mean, masked_quantile, tail_metrics


@given(st.integers(1, 70), st.integers(0, 10**6), st.sampled_from([50, 90, 95, 99]))
def test_tails_are_those_of_the_definition(n: int, seed: int, percent: int) -> None:
    """Rockafellar and Uryasev: the least of c + mean(max(x - c, 0)) / (1 - share), at one of the values."""
    values = np.random.default_rng(seed).gamma(0.5, 1.0, (3, n)).round(1)  # many equal ones
    quantile, cvar = tail_metrics(values, percent)
    for row, q, worst in zip(values, quantile, cvar, strict=True):
        wanted = min(c + np.maximum(row - c, 0.0).mean() / (1 - percent / 100) for c in row)
        # 1 - share is known to 1e-14 of itself, sums to a few roundings
        assert worst == pytest.approx(wanted, rel=1e-11, abs=1e-13)
        assert q == pytest.approx(np.quantile(row, percent / 100), rel=1e-12, abs=1e-15)
        assert row.mean() * (1 - 1e-12) <= worst <= row.max() * (1 + 1e-12)


def test_tails_by_literals() -> None:
    """Of 1 to 30 m s the worst 5 % are one and a half: 30, and half of 29; of 20 and of 40 they are whole numbers."""
    for n, quantile, cvar in ((30, 28.55, (30 + 0.5 * 29) / 1.5), (20, 19.05, 20.0), (40, 38.05, 39.5), (1, 1.0, 1.0)):
        found = tail_metrics(np.random.default_rng(n).permutation(np.arange(1.0, n + 1))[None])
        assert [one.item() for one in found] == pytest.approx([quantile, cvar], rel=1e-12), n


@given(st.integers(1, 30), st.integers(0, 10**6), st.sampled_from([0.05, 0.5, 0.95]))
def test_marked_columns_are_as_if_the_others_were_not_there(n: int, seed: int, share: float) -> None:
    generator = np.random.default_rng(seed)
    values = generator.gamma(1.0, 1.0, (4, n))
    values[generator.random((4, n)) < 0.1] = np.inf
    among = generator.random((4, n)) < generator.random((4, 1))
    found = masked_mean(values, among), masked_max(values, among), masked_quantile(values, among, share)
    for i in range(4):
        kept = np.sort(values[i, among[i]])
        if not kept.size:
            assert all(math.isnan(one[i]) for one in found)
            continue
        place = share * (kept.size - 1)
        low, high = kept[math.floor(place)], kept[math.ceil(place)]
        part = place - math.floor(place)
        quantile = low if low == high else low + (high - low) * part
        for one, wanted in zip(found, (kept.mean(), kept.max(), quantile), strict=True):
            assert one[i] == pytest.approx(wanted, rel=1e-12)
