"""Fits that run away, and what a fit warns of."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.special import log_ndtr

from helpers.examples import examples
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture.bounded_gaussian_mixture import correlation_of, fit_warnings
from ldctoolkit.mixture.checks import Events, profile_of

INF = np.inf

MARGINS = {
    "exponential": lambda rng, shape: rng.exponential(size=shape),
    "half_normal": lambda rng, shape: np.abs(rng.normal(size=shape)),
    "gamma_0.5": lambda rng, shape: rng.gamma(0.5, size=shape),
    "gamma_2": lambda rng, shape: rng.gamma(2.0, size=shape),
    "cauchy": lambda rng, shape: np.abs(rng.standard_cauchy(shape)),
}


def margin(name, shape, seed=1):
    # a gamma of 0.5 may round to zero, which is a bound
    return np.maximum(MARGINS[name](np.random.default_rng(seed), shape), 1e-300)


def fitted(X, K, *, lower=0.0, upper=INF, **kwargs):
    """A fit with every numpy warning an error."""
    wanted = {"random_state": 0, "n_init": 2, "split_merge": False} | kwargs
    with warnings.catch_warnings(), np.errstate(all="warn", under="ignore"):
        warnings.simplefilter("error")
        return BoundedGaussianMixture(K, lower=lower, upper=upper, **wanted).fit(X)


def check_sound(model, X):
    """Finite, positive definite, samples strictly inside, history never falls."""
    d = X.shape[1]
    box = [np.broadcast_to(np.asarray(side, dtype=float), d) for side in (model.lower, model.upper)]
    for value in (model.weights_, model.means_, model.covariances_, model.log_probabilities_):
        assert np.isfinite(value).all()
    deviation = np.sqrt(np.diagonal(model.covariances_, axis1=1, axis2=2))
    correlation = model.covariances_ / (deviation[:, :, None] * deviation[:, None, :])
    assert np.linalg.eigvalsh(correlation).min() > 0.0
    assert model.log_probabilities_.min() >= -1e5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        new, _ = model.sample(1500, 1)
        score = model.score(X)
    assert np.isfinite(new).all()
    assert np.all((new > box[0]) & (new < box[1]))
    assert np.isfinite(score)
    assert model.stop_reason_ in ("converged", "max_iter", "stuck", "collapsed")
    assert model.converged_ == (model.stop_reason_ == "converged")
    history = model.lower_bounds_
    assert np.min(np.diff(history), initial=0.0) >= -1e-8 * max(np.abs(history).max(), 1.0)


def grid(names, shapes, quick):
    """All names with all shapes; those that are not quick are for the longer tier."""
    return [
        pytest.param(name, *shape, marks=[] if (name, shape) in quick else pytest.mark.slow)
        for name in names
        for shape in shapes
    ]


@pytest.mark.parametrize(
    ("name", "d", "n", "K"),
    grid(
        MARGINS,
        [(1, 100, 1), (2, 2000, 1), (2, 2000, 3), (1, 20_000, 3), (5, 100, 3), (5, 1000, 1)],
        [("exponential", (2, 2000, 1)), ("gamma_0.5", (2, 2000, 3)), ("cauchy", (1, 100, 1))],
    ),
)
def test_density_piled_up_at_a_bound(name, d, n, K):
    """With the default prior a maximum exists, and the fit says that it got there; 5 to 230 passes were measured. One
    event in a thousand makes up a Cauchy margin's spread: its maximum may lie below the least ln P."""
    X = margin(name, (n, d))
    model = fitted(X, K)
    check_sound(model, X)
    assert model.converged_ or (name == "cauchy" and model.log_probabilities_.min() < -0.99e5)


@pytest.mark.parametrize(
    ("name", "d", "n", "K"),
    grid(
        MARGINS,
        [(1, 100, 1), (1, 100, 3), (2, 500, 1), (2, 500, 3)],
        [("exponential", (1, 100, 1)), ("gamma_0.5", (2, 500, 1)), ("gamma_2", (1, 100, 3))],
    ),
)
def test_density_piled_up_at_a_bound_without_a_prior(name, d, n, K):
    """There need be no maximum: the fit ends at the least ln P, or refuses."""
    X = margin(name, (n, d))
    try:
        model = fitted(X, K, prior_strength=0.0, max_iter=60)
    except InputError as error:
        assert "raise prior_strength" in str(error)  # noqa: PT017
    else:
        check_sound(model, X)


def best_of_one_dimension(x, n0):
    """Largest penalised log-likelihood per event of one normal above 0, by a general optimiser in (mu, ln sigma)."""
    z0 = -x.mean() / x.std()
    z = (x - x.mean()) / x.std()
    n, target = x.size, 1.0 * (1.0 - 2.0 / (x.size + 2.0)) + 2.0 / (x.size + 2.0)

    def loss(p):
        mu, sigma = p[0], np.exp(p[1])
        log_p = log_ndtr((mu - z0) / sigma)
        value = np.mean(-0.5 * ((z - mu) / sigma) ** 2) - p[1] - 0.5 * np.log(2 * np.pi) - log_p
        ratio = target / sigma**2
        return -(value + 0.5 * n0 * (np.log(ratio) - ratio + 1.0) / n)

    ends = [minimize(loss, [m, s], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 20_000})
            for m, s in ((0.0, 0.0), (-5.0, 1.0), (-50.0, 2.0))]  # fmt: skip
    return -min(end.fun for end in ends)


@pytest.mark.parametrize("name", ["exponential", "half_normal", "gamma_0.5", "gamma_2"])
def test_one_component_reaches_the_maximum_found_by_a_general_optimiser(name):
    """Newton's step ended 0.02 (exponential) and 0.13 nats (gamma of 0.5) short of it after 500 passes before."""
    x = margin(name, (5000, 1))
    model = fitted(x, 1, tol=1e-9)
    assert model.n_iter_ <= 20
    # 1e-6: the lattice's ln P at 1,021 points in one dimension is exact, the optimiser's stop is not
    assert abs(model.lower_bound_ - best_of_one_dimension(x[:, 0], 10.0)) < 1e-6


def base(n=500, d=2):
    return np.abs(np.random.default_rng(3).normal(size=(n, d))) + 1e-3


def noise(size):
    return np.random.default_rng(8).normal(size=500) * size


def with_copy(size):
    b = base()
    return np.column_stack([b[:, 0], 3.0 * b[:, 0] + 1.0 + noise(size), b[:, 1]])


def near(value):
    return np.where(np.random.default_rng(1).random((1000, 2)) < 0.3, value, base(1000))


def integers(d):
    return np.random.default_rng(1).poisson(2.0, size=(1000, d)).astype(float)


BROKEN = {
    "uniform": (lambda: np.random.default_rng(2).random((1000, 2)) * 0.999 + 5e-4, 3, 0.0, 1.0),
    "nearly constant, the same": (lambda: np.column_stack([base(), 1.0 + 1e-9 * base()[:, 0]]), 2, 0.0, INF),
    "nearly constant": (lambda: np.column_stack([base(), 1.0 + 1e-9 * base(500, 3)[:, 2]]), 2, 0.0, INF),
    "rows 50 times": (lambda: np.repeat(base(20), 50, axis=0), 6, 0.0, INF),
    "half of the rows the same": (lambda: np.vstack([base(250), np.tile(base(1), (250, 1))]), 3, 0.0, INF),
    "all rows but three the same": (lambda: np.vstack([base(3), np.tile(base(1), (250, 1))]), 3, 0.0, INF),
    "barely K, one": (lambda: base(3, 2), 1, 0.0, INF),
    "barely K, ten": (lambda: base(30, 2), 10, 0.0, INF),
    "barely K, ten, 5 columns": (lambda: base(60, 5), 10, 0.0, INF),
    "outlier": (lambda: np.vstack([base(500, 3), [[1e6, 1.0, 1.0]]]), 3, 0.0, INF),
    "outlier, K = 1": (lambda: np.vstack([base(500, 3), [[1e6, 1.0, 1.0]]]), 1, 0.0, INF),
    "outlier in all columns": (lambda: np.vstack([base(500, 3), [[1e6, 1e6, 1e6]]]), 3, 0.0, INF),
    "outlier, open": (lambda: np.vstack([noise(1.0).reshape(-1, 2), [[1e6, 0.0]]]), 2, -INF, INF),
    "same columns": (lambda: with_copy(0.0), 2, 0.0, INF),
    "same columns, open": (lambda: with_copy(0.0), 2, -INF, INF),
    "same columns to 1e-10": (lambda: with_copy(1e-10), 2, 0.0, INF),
    "same columns to 1e-6": (lambda: with_copy(1e-6), 2, 0.0, INF),
    "far apart in scale": (lambda: base(500, 3) * np.array([1e-12, 1.0, 1e12]), 3, 0.0, INF),
    "integers": (lambda: integers(2), 3, -0.5, INF),
    "integers, one column": (lambda: integers(1), 5, -0.5, INF),
    "zeros and ones at the bounds": (lambda: np.minimum(integers(2), 1.0), 3, -1e-9, 1.0 + 1e-9),
    "1e-15 from a bound": (lambda: near(1e-15), 3, 0.0, INF),
    "1e-300 from a bound": (lambda: near(1e-300), 3, 0.0, INF),
    "Cauchy": (lambda: np.random.default_rng(1).standard_cauchy((1000, 3)), 4, -INF, INF),
    "very heavy tail": (lambda: np.random.default_rng(1).pareto(0.3, (1000, 2)), 3, 0.0, INF),
    "K = 50": (lambda: np.random.default_rng(1).gamma(1.5, size=(1000, 2)), 50, 0.0, INF),
    "bounds far off": (base, 2, -1e6, 1e9),
    "far from zero": (lambda: base() * 1e3 + 1e12, 2, 0.0, INF),
}


QUICK = ("nearly constant", "half of the rows the same", "outlier, K = 1", "same columns", "far apart in scale")


@pytest.mark.parametrize(
    ("kind", "n0"),
    grid(BROKEN, [(10.0,), (0.0,)], [*((kind, (10.0,)) for kind in QUICK), *((kind, (0.0,)) for kind in QUICK[1:4:2])]),
)
def test_broken_data_give_a_sound_model_or_a_clear_refusal(kind, n0):
    make, K, lower, upper = BROKEN[kind]
    X = make()
    try:
        model = fitted(X, K, lower=lower, upper=upper, prior_strength=n0, max_iter=500 if n0 else 40)
    except InputError as error:
        assert n0 == 0.0
        assert "raise prior_strength" in str(error)  # noqa: PT017
    else:
        check_sound(model, X)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rows 50 times", "integers, one column", "1e-15 from a bound"])
def test_broken_data_and_the_moves_between_short_and_final_run(kind):
    make, K, lower, upper = BROKEN[kind]
    X = make()
    check_sound(fitted(X, K, lower=lower, upper=upper, split_merge=True), X)


@examples(15)
@given(
    seed=st.integers(0, 2**16), d=st.integers(1, 3), K=st.integers(1, 4), name=st.sampled_from(sorted(MARGINS)),
    step=st.sampled_from(["newton", "lee_scott"]), n0=st.sampled_from([0.0, 1.0, 10.0]), upper=st.booleans(),
)  # fmt: skip
def test_the_penalised_likelihood_never_falls(seed, d, K, name, step, n0, upper):
    X = margin(name, (60 * K, d), seed) @ (np.eye(d) + 0.3 * np.tri(d, k=-1))
    top = X.max(axis=0) * 1.01 if upper else INF
    try:
        model = fitted(X, K, upper=top, step=step, prior_strength=n0, max_iter=25)
    except InputError as error:
        assert "raise prior_strength" in str(error)  # noqa: PT017
        assert n0 == 0.0
    else:
        history = model.lower_bounds_
        assert np.min(np.diff(history), initial=0.0) >= -1e-8 * max(np.abs(history).max(), 1.0)


def told(model, X, names=None, weight=None):
    events = Events(np.asarray(X, dtype=float), weight)
    profile = profile_of(events)
    return fit_warnings(
        model.distribution, profile, correlation_of(events, profile), stop_reason=model.stop_reason_,
        passes=model.n_iter_, names=names,
    )  # fmt: skip


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
