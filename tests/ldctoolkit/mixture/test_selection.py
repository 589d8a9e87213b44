"""The number of components, and the criteria that choose it."""

import contextlib
import functools
import multiprocessing
import os
import time

import numpy as np
import pytest
from scipy.stats import truncnorm

from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.mixture import BoundedGaussianMixture, select_components
from ldctoolkit.mixture.checks import Events
from ldctoolkit.mixture.selection import Rule, choose, in_processes

INF = np.inf
QUICK = {"n_init": 2, "short_iter": 5, "random_state": 3}
CURVES = ("n_parameters", "log_likelihood", "bic", "aic")


def two_groups(n=600, seed=0):
    rng = np.random.default_rng(seed)
    return np.abs(rng.normal(size=(n, 2)) + np.repeat([[0.5, 1.0], [5.0, 6.0]], n // 2, axis=0)) + 1e-9


def assert_same(one, other):
    for name in ("n_components", *CURVES):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert (one.chosen, one.reason, one.failures) == (other.chosen, other.reason, other.failures)
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
        found = select_components(
            true.sample(1500, seed)[0], range(K - 1, K + 2),
            lower=true.lower, upper=true.upper, random_state=seed, n_init=3, n_jobs=2,
        )  # fmt: skip
        assert found.best.n_components == K, seed


# ---- criteria
@pytest.mark.parametrize("transform", [None, ["log", "none"]])
def test_criteria_equal_a_brute_force_computation(transform):
    X = two_groups()
    found = select_components(X, [1, 3], lower=[0.0, -INF], transform=transform, **QUICK)
    for i, model in enumerate(found.models):
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
        assert found.n_parameters[i] == p
        # 600 terms of size 1 to 10, each to about 1e-13
        np.testing.assert_allclose(found.log_likelihood[i], L / 600, rtol=1e-10)
        np.testing.assert_allclose(found.aic[i], -2 * L + 2 * p, rtol=1e-10)
        np.testing.assert_allclose(found.bic[i], -2 * L + p * np.log(600), rtol=1e-10)
        np.testing.assert_allclose(found.bic[i], model.bic(X), rtol=1e-10)


def test_aic_chooses_by_its_own_curve():
    """A hundred heavy-tailed values: twice the log-likelihood gains between 2 and ln 100 a parameter."""
    X = np.random.default_rng(2).standard_t(4, (100, 1))
    for criterion, K in (("bic", 1), ("aic", 2)):
        found = select_components(X, [1, 2], criterion=criterion, slack=0, **QUICK)
        assert found.best.n_components == K
        assert found.reason.startswith(f"K = {K}, the smallest whose {criterion.upper()} lies within 0 of the best")


def test_weights_count_as_repeated_rows():
    X = two_groups(400)
    times = np.random.default_rng(1).integers(0, 4, 400)
    options = {"lower": 0.0, "criterion": "bic", **QUICK}
    # one component: no start is drawn, so both fits take the same way
    weighted = select_components(X, [1], sample_weight=times, **options)
    repeated = select_components(np.repeat(X, times, axis=0), [1], **options)
    for name in CURVES:
        # the stopping point of the fits differs by rounding
        np.testing.assert_allclose(getattr(weighted, name), getattr(repeated, name), rtol=1e-8)
    # two: the weighted fit, seen on the repeated rows
    found = select_components(X, [2], sample_weight=times, **options)
    np.testing.assert_allclose(found.bic[0], found.best.bic(np.repeat(X, times, axis=0)), rtol=1e-10)


# ---- the rule
@pytest.mark.parametrize(
    ("loss", "allowed", "index"),
    [
        ([100.0, 50.0, 20.0, 12.0, 11.0, 14.0], 10.0, 2),
        ([100.0, 50.0, 21.0, 12.0, 11.0, 14.0], 10.0, 2),  # exactly as far as allowed
        ([100.0, 50.0, 21.1, 12.0, 11.0, 14.0], 10.0, 3),
        ([100.0, 50.0, 20.0, 12.0, 11.0, 14.0], 0.0, 4),
        ([7.0, 7.0, 7.0], 0.0, 0),  # flat
        ([1.0, 20.0, 40.0], 10.0, 0),  # rising
        ([40.0, 20.0, 1.0], 10.0, 2),  # falling
        ([3.0], 0.0, 0),
        ([np.nan, 30.0, 5.0, 4.0], 10.0, 2),
        ([-INF, 30.0, 5.0, INF], 10.0, 2),
    ],
)
def test_the_rule_on_made_up_curves(loss, allowed, index):
    assert choose(np.array(loss), allowed) == index


def test_no_finite_criterion_is_an_error():
    with pytest.raises(InputError, match="finite criterion"):
        choose(np.array([np.nan, INF]), 0.0)


def test_allowances_are_in_the_units_of_the_criterion():
    assert Rule("bic", 10.0, 0.0, 1000.0).allowance == 10.0
    assert Rule("bic", 3, 0.001, 1000.0).allowance == 3.0
    assert Rule("aic", 3, 0.01, 1000.0).allowance == 20.0


def test_the_reason_names_k_rule_and_limits():
    K, loss = np.array([1, 2, 3]), np.array([90.0, 4.0, 1.0])
    rule = Rule("bic", 10.0, 0.0, 100.0)
    assert rule.reason(K, loss, 1) == (
        "K = 2, the smallest whose BIC lies within 10 of the best (K = 3, better by 3.0); "
        "the best is the last one tried, so more components may be better still"
    )
    assert (
        Rule("aic", 10.0, 0.5, 100.0)
        .reason(K, loss, 0)
        .startswith("K = 1, the smallest whose AIC lies within 0.5 nats an event of the best (K = 3")
    )
    assert rule.reason(K[:1], loss[:1], 0) == "K = 1, the only one there is"


def test_indifference_takes_the_smaller_model():
    X = two_groups()
    plain = select_components(X, [1, 2], lower=0.0, **QUICK)
    gain = (plain.bic[0] - plain.bic.min()) / (2 * 600)
    just_less, just_more = (
        select_components(X, [1, 2], lower=0.0, indifference=factor * gain, **QUICK) for factor in (0.99, 1.01)
    )
    assert (plain.best.n_components, just_less.best.n_components, just_more.best.n_components) == (2, 2, 1)


def test_larger_k_are_not_tried_once_there_is_enough():
    """Sixty values of one group: K = 2 is worse than K = 1 by 12.3 units of BIC."""
    X = np.random.default_rng(0).standard_t(4, (60, 1))
    for slack, tried in ((10, [1, 2]), (13, [1, 2, 3])):
        found = select_components(X, [1, 2, 3], slack=slack, enough=lambda fits: fits.risen, **QUICK)
        assert found.n_components.tolist() == tried


# ---- in parallel
@contextlib.contextmanager
def no_process_stays():
    """None that the block starts; those of other tests may still wait for work."""
    before = set(multiprocessing.active_children())
    yield
    assert set(multiprocessing.active_children()) <= before


def test_numbers_do_not_depend_on_processes():
    X = two_groups()
    options = {"lower": 0.0, "sample_weight": np.linspace(0.5, 2.0, 600), **QUICK}
    # 201 components are too many for 600 rows
    serial = select_components(X, [1, 2, 201], n_jobs=1, **options)
    with no_process_stays():
        parallel = select_components(X, [201, 2, 1], n_jobs=3, **options)
    assert_same(serial, parallel)
    assert serial.failures[0].n_components == 201


@pytest.mark.slow
def test_processes_that_start_afresh_map_the_events():
    events = Events(two_groups(), np.linspace(0.5, 2.0, 600))
    ended = dict(in_processes(_sums, [1.0, 2.0], events, 2))
    total = float(np.sum(events.weight @ events.x))
    assert ended == {0: (total, True), 1: (2 * total, True)}


def _sums(events, factor):
    return factor * float(np.sum(events.weight @ events.x)), isinstance(events.x, np.memmap)


def _broken(events, job, asleep=None):
    if job == "raise":
        while not asleep.exists():
            time.sleep(0.01)
        raise InputError(f"job {job} of {events.x.shape[0]} rows")
    if job == "die":
        os._exit(3)
    if job == "sleep":
        asleep.touch()
        time.sleep(600)
        asleep.unlink()
    return job


@pytest.mark.slow
def test_an_error_in_a_worker_arrives_as_it_is(tmp_path):
    """And it waits for no other job that is under way."""
    work = functools.partial(_broken, asleep=tmp_path / "asleep")
    with no_process_stays(), pytest.raises(InputError, match="job raise of 600 rows"):
        list(in_processes(work, ["sleep", "raise"], Events(two_groups()), 2))
    assert (tmp_path / "asleep").exists()


@pytest.mark.slow
def test_a_worker_that_dies_is_told():
    with no_process_stays(), pytest.raises(LdcError, match=r"ended abruptly.*n_jobs=1"):
        list(in_processes(_broken, ["die", "x"], Events(two_groups()), 2))


@pytest.mark.slow
def test_an_interrupt_ends_the_workers():
    def interrupt(text, done, total):
        if done:
            raise KeyboardInterrupt

    # at once, not when the traceback and what it holds are dropped
    with no_process_stays(), pytest.raises(KeyboardInterrupt) as caught:
        select_components(two_groups(), range(1, 5), lower=0.0, n_jobs=2, progress=interrupt, **QUICK)
    assert caught.traceback


@pytest.mark.parametrize(("n_jobs", "first"), [(1, "K = 1"), pytest.param(2, "K = 3, 2", marks=pytest.mark.slow)])
def test_progress(n_jobs, first):
    seen = []
    select_components(two_groups(), [1, 2, 3], lower=0.0, n_jobs=n_jobs, progress=lambda *a: seen.append(a), **QUICK)
    assert (seen[0], [s[1] for s in seen], seen[-1]) == ((first, 0, 3), [0, 1, 2, 3], ("done", 3, 3))


def test_a_seed_may_be_a_generator():
    X = two_groups()
    made = [select_components(X, [1, 2], random_state=np.random.default_rng(1), n_init=2) for _ in range(2)]
    assert_same(*made)
    assert made[0].models[0].random_state == made[0].models[1].random_state


# ---- what cannot be fitted
def test_a_k_that_cannot_be_fitted_is_reported_and_left_out():
    found = select_components(two_groups(40), [1, 2, 14], lower=0.0, **QUICK)
    assert found.n_components.tolist() == [1, 2]
    assert len(found.models) == found.bic.size == 2
    assert [f.n_components for f in found.failures] == [14]
    assert "at least K (d + 1) = 42" in found.failures[0].message
    assert found.reason.endswith("; K = 14 could not be fitted")


@pytest.mark.parametrize("n_jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_where_all_fail_the_message_is_the_fits(n_jobs):
    X = two_groups()
    X[7, 1] = -1.0
    with pytest.raises(InputError, match=r"column 1, row 7: -1.0; allowed: strictly between"):
        select_components(X, [1, 2], lower=0.0, n_jobs=n_jobs, **QUICK)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"components": []}, "components: an empty range"),
        ({"components": 3}, "components: 3; allowed: an integer >= 1, or several"),
        ({"components": "12"}, "components: '12'; allowed: an integer >= 1, or several"),
        ({"components": [0, 1]}, "components: 0; allowed: an integer >= 1"),
        ({"components": [1, "2"]}, "components: '2'"),
        ({"criterion": "bci"}, "criterion: 'bci'; did you mean 'bic'"),
        ({"criterion": ["bic"]}, "criterion: "),
        ({"slack": -1.0}, "slack: -1.0; allowed: a number >= 0"),
        ({"indifference": np.nan}, "indifference: nan"),
        ({"n_jobs": 0}, "n_jobs: 0; allowed: an integer >= 1"),
        ({"sample_weight": [1.0]}, "sample_weight: shape"),
        ({"X": np.empty((0, 2))}, "X: no rows"),
        ({"X": np.empty((5, 0))}, "X: no columns"),
        ({"X": [["a"]]}, "X: not a table of numbers"),
        ({"tol": -1.0}, "tol: -1.0"),
    ],
)
def test_bad_input_is_named(change, message):
    arguments = {"X": two_groups(), "components": [1], **QUICK, **change}
    with pytest.raises(InputError, match=message.replace("[", r"\[")) as caught:
        select_components(**arguments)
    assert "np.float64" not in str(caught.value)


def test_an_unknown_setting_is_told_before_anything_starts():
    with pytest.raises(TypeError, match="n_initial"):
        select_components(two_groups(), [1], n_initial=3)


def two_components(lower=None):
    return BoundedGaussianMixture.from_parameters(
        [0.4, 0.6], [[0.0, 1.0], [1.5, 0.5]], [[[1.0, 0.3], [0.3, 0.5]], [[0.4, 0.0], [0.0, 0.8]]], lower=lower
    )


def test_open_mixtures_have_scikit_learns_criteria():
    from sklearn.mixture import GaussianMixture

    ours = two_components()
    theirs = GaussianMixture(2)
    theirs.weights_, theirs.means_ = ours.weights_, ours.means_
    theirs.covariances_ = ours.covariances_
    theirs.precisions_cholesky_ = np.linalg.cholesky(np.linalg.inv(ours.covariances_)).copy()
    X = ours.sample(500, 1)[0]
    np.testing.assert_allclose(ours.aic(X), theirs.aic(X), rtol=1e-12)
    np.testing.assert_allclose(ours.bic(X), theirs.bic(X), rtol=1e-12)


def test_bad_weights_and_no_rows():
    model = two_components()
    with pytest.raises(InputError, match="sample_weight: shape"):
        model.bic([[0.0, 1.0]], sample_weight=[1.0, 2.0])
    with pytest.raises(InputError, match="X: no rows"):
        model.aic(np.empty((0, 2)))
