"""``[design.sample]``: points that fill a design space evenly, instead of a full grid."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from ldctoolkit.errors import InputError
from studies.study_file._part import Part, fail


class SampleSettings(Part):
    """``[design.sample]``: how many points of the space are taken, and how they are spread.

    Attributes
    ----------
    method : {"latin_hypercube", "sobol", "saltelli"}
        Latin hypercube: every dimension is cut into `count` equal parts and each part is met once. Sobol: the first
        points of a scrambled Sobol sequence, best as a power of two. Saltelli: what Sobol indices are computed from.
    count : int
        Points for each law; with ``"saltelli"`` the number N of base points, a power of two, which make N (d + 2)
        designs in d dimensions.
    seed : int
        Of the sample; nothing else decides the points.
    """

    method: Literal["latin_hypercube", "sobol", "saltelli"]
    count: int = Field(ge=1, le=100_000)
    seed: int = Field(default=0, ge=0, lt=2**63)

    @model_validator(mode="after")
    def _balanced(self) -> Self:
        if self.method == "saltelli" and self.count & (self.count - 1):
            below = 1 << (self.count.bit_length() - 1)
            message = f"{self.count}; allowed with 'saltelli': a power of two, e.g. {below} or {2 * below}"
            raise fail("count", message)
        return self

    def points(self, dimensions: int) -> int:
        """Number of points in so many dimensions; one in a space without any."""
        if not dimensions:
            return 1
        return self.count * (dimensions + 2) if self.method == "saltelli" else self.count


def unit_points(sample: SampleSettings, dimensions: int) -> npt.NDArray[np.float64]:
    """The points of a sample in the unit cube.

    Parameters
    ----------
    sample : SampleSettings
    dimensions : int
        Number of dimensions that vary.

    Returns
    -------
    (m, dimensions)
        From 0 to 1. The rows of a Saltelli sample are in the order that `SALib.analyze.sobol.analyze` expects of a
        sample without second-order indices.

    Raises
    ------
    InputError
        For a Saltelli sample without SALib.

    Examples
    --------
    >>> unit_points(SampleSettings(method="sobol", count=4), 2).shape
    (4, 2)
    """
    if not dimensions:
        return np.zeros((1, 0))
    if sample.method == "saltelli":
        return _saltelli(sample, dimensions)
    from scipy.stats import qmc

    rng = np.random.default_rng(sample.seed)
    if sample.method == "latin_hypercube":
        points = qmc.LatinHypercube(dimensions, rng=rng).random(sample.count)
    else:
        # drawn as a power of two and cut: the same points, and SciPy has nothing to warn of
        points = qmc.Sobol(dimensions, rng=rng).random_base2((sample.count - 1).bit_length())[: sample.count]
    return np.asarray(points, dtype=np.float64)


def _saltelli(sample: SampleSettings, dimensions: int) -> npt.NDArray[np.float64]:
    try:
        from SALib.sample import sobol
    except ImportError:
        message = "design.sample.method: 'saltelli' needs SALib, which is not installed"
        raise InputError(f'{message}; install the extra: pip install "ldctoolkit[sensitivity]"') from None
    cube = {
        "num_vars": dimensions,
        "names": [str(i) for i in range(dimensions)],
        "bounds": [[0.0, 1.0]] * dimensions,
    }
    points = sobol.sample(cube, sample.count, calc_second_order=False, seed=sample.seed)
    return np.asarray(points, dtype=np.float64)
