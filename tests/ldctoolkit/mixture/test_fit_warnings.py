"""Sentences about a fit: each defect is named, a sound fit is not."""

import numpy as np
import pytest

from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture.bounded_gaussian_mixture import correlation_of, fit_warnings
from ldctoolkit.mixture.checks import Events, profile_of

INF = np.inf


def told(model, X, names=None, weight=None):
    events = Events(np.asarray(X, dtype=float), weight)
    profile = profile_of(events)
    return fit_warnings(
        model.distribution, profile, correlation_of(events, profile), stop_reason=model.stop_reason_,
        passes=model.n_iter_, names=names,
    )  # fmt: skip


def base(n=500, d=2):
    return np.abs(np.random.default_rng(3).normal(size=(n, d))) + 1e-3


def fit(X, K=1, **settings):
    return BoundedGaussianMixture(K, **{"lower": 0.0, "random_state": 0, "n_init": 2} | settings).fit(X)


def test_a_sound_fit_has_nothing_to_tell():
    X = BoundedGaussianMixture.from_parameters(
        [0.4, 0.6], [[0.2, 0.0], [2.0, 3.0]], [np.eye(2), 0.5 * np.eye(2)], lower=[0.0, -INF]
    ).sample(1500, 0)[0]
    assert told(fit(X, 2, lower=[0.0, -INF]), X) == ()


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("max_iter", "Not converged in 3 passes: raise max_iter"),
        ("stuck", "after 3 passes no step raised the likelihood"),
        ("collapsed", "too thin for the arithmetic"),
    ],
)
def test_a_fit_that_did_not_converge(reason, words):
    X = base()
    model = fit(X)
    model.stop_reason_, model.n_iter_ = reason, 3
    first, *rest = told(model, X)
    assert words in first
    assert rest == []


def test_components_with_fewer_events_than_parameters():
    X = base(12)
    model = fit(X, 4)
    few = [str(k) for k in range(4) if model.weights_[k] * 12 < 5.0]
    assert len(few) > 1
    sentence = told(model, X)[0]
    assert sentence.startswith(f"Components {', '.join(few)} (")
    assert "fewer than the 5 parameters of a mean and a covariance" in sentence
    # weights count: the same rows for ten events each are enough
    assert not any("fewer than" in s for s in told(model, X, weight=np.full(12, 100.0)))


def test_many_components_are_not_all_listed():
    X = base(60)
    sentence = next(s for s in told(fit(X, 20, split_merge=False, n_init=1, max_iter=5), X) if "fewer than" in s)
    names, figures = sentence.split(" (")
    assert names.endswith(", ...")
    assert names.count(",") == figures.split(" events")[0].count(",") == 6


def test_events_piled_up_at_a_bound():
    X = np.random.default_rng(1).exponential(size=(20_000, 1))
    model = fit(X)
    (sentence,) = told(model, X)
    assert sentence.startswith(f"Component 0 (ln P {model.log_probabilities_[0]:.3g}; ")
    distance = -model.means_[0, 0] / np.sqrt(model.covariances_[0, 0, 0])
    assert f"; {distance:.3g} standard deviations outside the box): events pile up" in sentence


@pytest.mark.slow
def test_columns_that_are_nearly_the_same():
    b = base()
    for noise, other in ((0.0, "1"), (1e-10, "1"), (1e-3, "0.99999")):
        X = np.column_stack([b[:, 0], 3.0 * b[:, 0] + 1.0 + noise * b[:, 1], b[:, 1]])
        sentences = told(fit(X), X, names=("T", "d_y", "c_0"))
        assert sentences[0].startswith(f"Column 'T' and column 'd_y' are nearly the same (correlation {other}")
        assert len(sentences) == 1
    X[:, 1] *= -1.0
    assert "(correlation -0.99999" in told(fit(X, lower=-INF), X)[0]


def test_one_event_far_off():
    X = np.vstack([base(500, 3), [[1.0, 1e6, 1.0]]])
    text = " ".join(told(fit(X, 2), X))
    assert "Column 1: one event, 1e+06, makes up 100% of the variance; is it real?" in text
    X = np.vstack([base(500, 3), [[1.0, 1.0, -1e6]]])
    assert "Column 2: one event, -1e+06, makes up" in " ".join(told(fit(X, 2, lower=-INF), X))


def test_a_column_that_hardly_varies():
    X = np.column_stack([base(), 1.0 + 1e-9 * base(500, 3)[:, 2]])
    assert any(s.startswith("Column 2 varies by ") and "few digits are left" in s for s in told(fit(X), X))


@pytest.mark.slow
def test_repeated_rows_make_thin_components():
    X = np.vstack([base(250), np.tile([[1.0, 1.0]], (250, 1))])
    assert any("hardly any width in some direction" in s for s in told(fit(X, 3, prior_strength=0.1), X))


def test_correlation_is_numpys():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(16_389, 3)) @ rng.normal(size=(3, 3)) * [1e-6, 1.0, 1e6] + 3.0
    events = Events(X)
    np.testing.assert_allclose(correlation_of(events, profile_of(events)), np.corrcoef(X.T), rtol=1e-10, atol=1e-13)
    w = rng.uniform(size=X.shape[0])
    events = Events(X, w)
    C = np.cov(X.T, aweights=w)
    expected = C / np.sqrt(np.outer(np.diag(C), np.diag(C)))
    np.testing.assert_allclose(correlation_of(events, profile_of(events)), expected, rtol=1e-10, atol=1e-13)
