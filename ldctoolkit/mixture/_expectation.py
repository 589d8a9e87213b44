"""E-step: components as coefficients of the features (1, x_i, x_i x_j), feature sums as weighted moments."""

import dataclasses

import numpy as np

from ldctoolkit.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class Components:
    """Parameters of K components in the coordinates of the data."""

    weights: FloatArray  # (K,): eta_k, the share of events
    mu: FloatArray  # (K, d): means before truncation
    Sigma: FloatArray  # (K, d, d): covariances before truncation
    log_p: FloatArray  # (K,): logarithm of the probability of the box


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Sums of an E-step."""

    log_likelihood: float  # sum of ln f over the events
    counts: FloatArray  # (K,): expected events N_k
    mean: FloatArray  # (K, d): weighted means
    scatter: FloatArray  # (K, d, d): weighted covariances about those means


def natural(c: Components) -> FloatArray:
    """Coefficients (K, features) of ln(eta_k g_k/P_k)."""
    d = c.mu.shape[1]
    i, j = np.triu_indices(d)
    precision = np.linalg.inv(c.Sigma)
    linear = (precision @ c.mu[:, :, None])[:, :, 0]
    _, log_det = np.linalg.slogdet(c.Sigma)
    with np.errstate(divide="ignore"):
        constant = np.log(c.weights) - c.log_p
    constant = constant - 0.5 * (d * np.log(2.0 * np.pi) + log_det + np.sum(c.mu * linear, axis=1))
    quadratic = -precision[:, i, j] * np.where(i == j, 0.5, 1.0)
    return np.concatenate([np.maximum(constant, -1e300)[:, None], linear, quadratic], axis=1)


def log_density(x: FloatArray, c: Components, location: FloatArray, scale: FloatArray) -> FloatArray:
    """Logarithm of sum_k eta_k g_k/P_k of each row, (n,); components in (x - location)/scale, no check of the box."""
    from ldctoolkit.mixture._kernels import log_density_of_rows  # here: the compiler is slow to import

    return log_density_of_rows(x, location, scale, natural(c))


def log_terms(z: FloatArray, c: Components) -> FloatArray:
    """Terms ln(eta_k g_k(z)/P_k), (n, K), without a check that z is inside the box."""
    i, j = np.triu_indices(z.shape[1])
    features = np.concatenate([np.ones((z.shape[0], 1)), z, z[:, i] * z[:, j]], axis=1)
    out: FloatArray = features @ natural(c).T
    return out


def shares(logits: FloatArray) -> FloatArray:
    """Row-wise shares (n, K), summing to one."""
    share = np.exp(logits - logits.max(axis=1, keepdims=True))
    out: FloatArray = share / share.sum(axis=1, keepdims=True)
    return out


def statistics(log_likelihood: float, sums: FloatArray, d: int) -> Statistics:
    """Weighted moments from feature sums (K, features)."""
    i, j = np.triu_indices(d)
    counts = sums[:, 0]
    safe = np.maximum(counts, 1e-300)[:, None]
    mean = sums[:, 1 : 1 + d] / safe
    second = np.empty((sums.shape[0], d, d))
    second[:, i, j] = second[:, j, i] = sums[:, 1 + d :] / safe
    return Statistics(log_likelihood, counts, mean, second - mean[:, :, None] * mean[:, None, :])
