"""AIC and BIC of a fitted mixture."""

import numpy as np
import pytest

from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture


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
