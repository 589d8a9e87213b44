"""The number of components, and the criterion that chooses it."""

import concurrent.futures

import numpy as np
import pytest
from scipy.stats import truncnorm

from helpers.errors import refused
from ldctoolkit.errors import NOT_GIVEN, UnknownArgumentError
from ldctoolkit.mixture import BoundedGaussianMixture, select_components
from ldctoolkit.mixture.selection import choose, reason_of

INF = np.inf
QUICK = {"n_init": 2, "short_iter": 5, "random_state": 3}
CURVES = ("n_parameters", "log_likelihood", "bic")


def two_groups(n=600, seed=0):
    rng = np.random.default_rng(seed)
    return np.abs(rng.normal(size=(n, 2)) + np.repeat([[0.5, 1.0], [5.0, 6.0]], n // 2, axis=0)) + 1e-9


def assert_same(one, other):
    for name in ("n_components", *CURVES):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert (one.chosen, one.reason) == (other.chosen, other.reason)
    failures = ([(f.n_components, str(f.error)) for f in selection.failures] for selection in (one, other))
    assert next(failures) == next(failures)
    for a, b in zip(one.models, other.models, strict=True):
        np.testing.assert_array_equal(a.weights_, b.weights_)
        np.testing.assert_array_equal(a.means_, b.means_)
        np.testing.assert_array_equal(a.covariances_, b.covariances_)


# ---- the right K

TRUTHS = {0: (2, 3), 1: (3, 4), 2: (4, 5), 8: (5, 3), 9: (6, 5)}  # K and d of each seed


def separated(seed):
    """Means at least 5 apart, spreads of about one, a bound near one of them; column 0 has two bounds, column 1 one."""
    K, d = TRUTHS[seed]
    rng = np.random.default_rng([7, seed])
    mu, gap = np.ones((K, d)), np.zeros((K, K))
    while gap.min() <= 5.0 or mu[:, :2].min() > 0.3:
        mu = rng.uniform(-0.5, 10.5, (K, d))
        gap = np.linalg.norm(mu[:, None] - mu, axis=2) + np.diag(np.full(K, INF))
    A = rng.normal(size=(K, d, d))
    Sigma = A @ A.transpose(0, 2, 1) / d * 0.5 + 0.5 * np.eye(d)
    lower, upper = np.full(d, -INF), np.full(d, INF)
    lower[:2], upper[0] = 0.0, 10.0
    eta = rng.dirichlet(np.full(K, 10.0))
    return BoundedGaussianMixture.from_parameters(eta, mu, Sigma, lower=lower, upper=upper)


@pytest.mark.slow
def test_bic_finds_the_true_k():
    """Acceptance: one component less or more is never chosen; the bounds cut components in every truth."""
    for seed, (K, _) in TRUTHS.items():
        true = separated(seed)
        assert np.exp(true.log_probabilities_.min()) < 0.75
        selection = select_components(
            true.sample(1500, seed)[0], range(K - 1, K + 2),
            lower=true.lower, upper=true.upper, random_state=seed, n_init=3, n_jobs=2,
        )  # fmt: skip
        assert selection.best.n_components == K, seed


# ---- the criterion
@pytest.mark.parametrize("transform", [None, ["log", "none"]])
def test_bic_equals_a_brute_force_computation(transform):
    X = two_groups()
    selection = select_components(X, [1, 3], lower=[0.0, -INF], transform=transform, **QUICK)
    for i, model in enumerate(selection.models):
        K, d = model.means_.shape
        Y = X.copy()
        if transform is not None:
            Y[:, 0] = np.log(X[:, 0])
        log_terms = np.empty((X.shape[0], K))
        for k in range(K):
            mu, Sigma = model.means_[k], model.covariances_[k]
            gap = Y - mu
            # only the first column is bounded, so P is its margin's
            bound = -mu[0] / np.sqrt(Sigma[0, 0]) if transform is None else -INF
            log_p = truncnorm(-INF, INF).logsf(bound) if np.isfinite(bound) else 0.0
            log_terms[:, k] = (
                np.log(model.weights_[k]) - log_p - 0.5 * np.log(np.linalg.det(2 * np.pi * Sigma))
                - 0.5 * np.einsum("ni,ij,nj->n", gap, np.linalg.inv(Sigma), gap)
            )  # fmt: skip
        density = np.exp(log_terms).sum(axis=1)
        L = np.log(density).sum() - (0.0 if transform is None else Y[:, 0].sum())
        p = K * d + K * d * (d + 1) // 2 + K - 1
        assert selection.n_parameters[i] == p
        # 600 terms of size 1 to 10, each to about 1e-13
        np.testing.assert_allclose(selection.log_likelihood[i], L / 600, rtol=1e-10)
        np.testing.assert_allclose(selection.bic[i], -2 * L + p * np.log(600), rtol=1e-10)
        np.testing.assert_allclose(selection.bic[i], model.bic(X), rtol=1e-10)


def test_weights_count_as_repeated_rows():
    X = two_groups(400)
    times = np.random.default_rng(1).integers(0, 4, 400)
    options = {"lower": 0.0, **QUICK}
    # one component: no start is drawn, so both fits take the same way
    weighted = select_components(X, [1], sample_weight=times, **options)
    repeated = select_components(np.repeat(X, times, axis=0), [1], **options)
    for name in CURVES:
        # the stopping point of the fits differs by rounding
        np.testing.assert_allclose(getattr(weighted, name), getattr(repeated, name), rtol=1e-8)
    # two: the weighted fit, seen on the repeated rows
    selection = select_components(X, [2], sample_weight=times, **options)
    np.testing.assert_allclose(selection.bic[0], selection.best.bic(np.repeat(X, times, axis=0)), rtol=1e-10)


# ---- the rule
@pytest.mark.parametrize(
    ("bic", "index"),
    [
        ([100.0, 50.0, 20.0, 12.0, 11.0, 14.0], 2),
        ([100.0, 50.0, 21.0, 12.0, 11.0, 14.0], 2),  # exactly as far as allowed
        ([100.0, 50.0, 21.1, 12.0, 11.0, 14.0], 3),
        ([7.0, 7.0, 7.0], 0),  # flat
        ([1.0, 20.0, 40.0], 0),  # rising
        ([40.0, 20.0, 1.0], 2),  # falling
        ([3.0], 0),
        ([np.nan, 30.0, 5.0, 4.0], 2),
        ([-INF, 30.0, 5.0, INF], 2),
    ],
)
def test_the_rule_on_invented_curves(bic, index):
    assert choose(np.array(bic)) == index


def test_no_finite_criterion_is_an_error():
    with refused("components", allowed="at least one"):
        choose(np.array([np.nan, INF]))


def test_the_reason_names_k_rule_and_limits():
    K, bic = np.array([1, 2, 3]), np.array([90.0, 4.0, 1.0])
    assert reason_of(K, bic, 1) == (
        "K = 2, the smallest whose BIC lies within 10 of the best (K = 3, better by 3.0); "
        "the best is the last one tried, so more components may be better still"
    )
    assert reason_of(K[:1], bic[:1], 0) == "K = 1, the only one there is"


@pytest.mark.parametrize(("n", "tried"), [(60, [1, 2]), (20, [1, 2, 3])])
def test_larger_k_are_not_tried_once_bic_has_risen(n, tried):
    """One group: each further component costs three parameters, 12.3 units of BIC at n = 60, 9 or less at n = 20."""
    X = np.random.default_rng(0).standard_t(4, (n, 1))
    selection = select_components(X, [1, 2, 3], enough=lambda fits: fits.risen, **QUICK)
    assert selection.n_components.tolist() == tried


# ---- in parallel
def test_numbers_depend_neither_on_the_order_nor_on_cores():
    X = two_groups()
    options = {"lower": 0.0, "sample_weight": np.linspace(0.5, 2.0, 600), **QUICK}
    # 201 components are too many for 600 rows
    serial = select_components(X, [1, 2, 201], n_jobs=1, **options)
    assert_same(serial, select_components(X, [201, 2, 1], n_jobs=2, **options))
    assert serial.failures[0].n_components == 201


def test_what_runs_the_fits_may_be_passed_in():
    """As `map`, here by threads; the longest fit is handed over first."""
    handed_over = []

    def by_threads(fit, models):
        handed_over.extend(model.n_components for model in models)
        with concurrent.futures.ThreadPoolExecutor(2) as pool:
            return list(pool.map(fit, models))

    serial = select_components(two_groups(), [1, 2, 3], lower=0.0, n_jobs=1, **QUICK)
    assert_same(select_components(two_groups(), [1, 2, 3], lower=0.0, fit_each=by_threads, **QUICK), serial)
    assert handed_over == [3, 2, 1]
    assert_same(select_components(two_groups(), [1, 2, 3], lower=0.0, fit_each=map, **QUICK), serial)


def reverse_map(fit, models):
    """Results in another order."""
    return reversed([fit(model) for model in models])


@pytest.mark.parametrize(("fit_each", "first"), [(None, "K = 1"), (reverse_map, "K = 3")])
def test_progress(fit_each, first):
    seen = []
    options = {"lower": 0.0, "fit_each": fit_each, "progress": lambda *a: seen.append(a), **QUICK}
    select_components(two_groups(), [1, 2, 3], **options)
    assert (seen[0], [s[1] for s in seen], seen[-1]) == ((first, 0, 3), [0, 1, 2, 3], ("done", 3, 3))


def test_a_seed_may_be_a_generator():
    X = two_groups()
    made = [select_components(X, [1, 2], random_state=np.random.default_rng(1), n_init=2) for _ in range(2)]
    assert_same(*made)
    assert made[0].models[0].random_state == made[0].models[1].random_state


# ---- what cannot be fitted
def test_a_k_that_cannot_be_fitted_is_reported_and_left_out():
    selection = select_components(two_groups(40), [1, 2, 14], lower=0.0, **QUICK)
    assert selection.n_components.tolist() == [1, 2]
    assert len(selection.models) == selection.bic.size == 2
    assert [f.n_components for f in selection.failures] == [14]
    assert (selection.failures[0].error.path, selection.failures[0].error.problem) == ("X", "40 rows")
    assert selection.reason.endswith("; K = 14 could not be fitted")


@pytest.mark.parametrize("fit_each", [map, reverse_map])
def test_where_all_fail_the_error_is_that_of_the_smallest(fit_each):
    X = two_groups()
    X[7, 1] = -1.0
    with refused("X: column 1, row 7", value=-1.0, allowed="strictly between the bounds 0 and inf"):
        select_components(X, [1, 2], lower=0.0, fit_each=fit_each, **QUICK)
    with refused("X", allowed="at least K (d + 1) = 6 for K = 2, d = 2"):
        select_components(X[:4], [3, 2], lower=0.0, fit_each=fit_each, **QUICK)


@pytest.mark.parametrize(
    ("change", "path", "value"),
    [
        ({"components": 3}, "components", 3),
        ({"components": "12"}, "components", "12"),
        ({"components": [0, 1]}, "components", 0),
        ({"components": [1, "2"]}, "components", "2"),
        ({"components": [1.0]}, "components", 1.0),
        ({"components": [True]}, "components", True),
        ({"n_jobs": 0}, "n_jobs", 0),
        ({"tol": -1.0}, "tol", -1.0),
        ({"components": []}, "components", NOT_GIVEN),
        ({"sample_weight": [1.0]}, "sample_weight", NOT_GIVEN),
        ({"X": np.empty((0, 2))}, "X", NOT_GIVEN),
        ({"X": np.empty((5, 0))}, "X", NOT_GIVEN),
        ({"X": [["a"]]}, "X", NOT_GIVEN),
    ],
)
def test_bad_input_is_named(change, path, value):
    with refused(path, value=value):
        select_components(**{"X": two_groups(), "components": [1], **QUICK, **change})


def test_an_unknown_setting_is_refused_before_anything_starts():
    with refused("BoundedGaussianMixture", UnknownArgumentError, value="n_initial"):
        select_components(two_groups(), [1], n_initial=3)


def test_bad_weights_and_no_rows():
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.0, 1.0]], [np.eye(2)])
    with refused("sample_weight"):
        model.bic([[0.0, 1.0]], sample_weight=[1.0, 2.0])
    with refused("X"):
        model.bic(np.empty((0, 2)))
