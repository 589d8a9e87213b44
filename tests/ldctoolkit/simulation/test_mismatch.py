"""True vehicles: distribution of the factors, the nominal vehicle to the bit, matrices vehicle by vehicle."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from ldctoolkit import BicycleModel, Scenarios, VehicleParameters
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import Mismatch, Tyres
from ldctoolkit.simulation.takeover import true_vehicles
from ldctoolkit.vehicle import Convention

NOMINAL = VehicleParameters(C_af=61000.0, C_ar=93000.0, l_f=1.1, l_r=1.7, m=1573.3, I_z=2873.7)
RANGES = Mismatch(m=(0.9, 1.4), I_z=(0.8, 1.3), C_af=(0.6, 1.1), C_ar=(0.7, 1.2), mu=(0.3, 1.0))
TYRES = Tyres(model="magic_formula", mu=0.87)
NAMES = ("m", "I_z", "C_af", "C_ar", "mu")
MANY = Scenarios.from_arrays(T=np.full(20_000, 2.0), d_y=0.3, v_mean=20.0)


def nominal(name: str) -> float:
    return TYRES.mu if name == "mu" else float(getattr(NOMINAL, name))


def test_factors_are_uniform_on_their_ranges_and_independent() -> None:
    true = true_vehicles(NOMINAL, RANGES, TYRES, MANY, seed=3)
    factors = []
    for name in NAMES:
        low, high = getattr(RANGES, name)
        share = (getattr(true, name) / nominal(name) - low) / (high - low)
        # a fixed seed: the test decides once
        assert scipy.stats.kstest(share, "uniform").pvalue > 1e-3, name
        factors.append(share)
    correlation = np.corrcoef(factors) - np.eye(5)
    assert np.abs(correlation).max() < 4 / np.sqrt(MANY.n)


@given(st.floats(0.05, 5.0), st.floats(0.0, 5.0), st.integers(0, 2**63 - 1))
def test_factors_stay_in_their_ranges(low: float, width: float, seed: int) -> None:
    few = MANY.take(slice(50))
    true = true_vehicles(NOMINAL, Mismatch(C_ar=(low, low + width)), Tyres(), few, seed)
    assert np.all(true.C_ar >= low * NOMINAL.C_ar)
    assert np.all(true.C_ar <= (low + width) * NOMINAL.C_ar)


@pytest.mark.parametrize("ranges", [Mismatch(), Mismatch(mu=(0.3, 1.0))])
def test_a_range_of_one_leaves_the_nominal_number(ranges: Mismatch) -> None:
    true = true_vehicles(NOMINAL, ranges, TYRES, MANY, seed=3)
    for name in NAMES[:4]:
        assert set(getattr(true, name)) == {nominal(name)}
    assert np.unique(true.mu).size == (1 if ranges.ideal else MANY.n)
    assert (true.l_f, true.l_r) == (NOMINAL.l_f, NOMINAL.l_r)
    v = np.linspace(1.0, 60.0, MANY.n)
    for ours, theirs in zip(true.matrices(v, "consistent"), BicycleModel(NOMINAL).matrices(v), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_factor_does_not_depend_on_other_ranges() -> None:
    alone = true_vehicles(NOMINAL, Mismatch(C_ar=RANGES.C_ar), Tyres(), MANY, seed=3)
    np.testing.assert_array_equal(alone.C_ar, true_vehicles(NOMINAL, RANGES, TYRES, MANY, seed=3).C_ar)


@pytest.mark.parametrize("convention", ["consistent", "as_printed"])
def test_matrices_and_steady_cornering_equal_one_model_each(convention: Convention) -> None:
    few = MANY.take(slice(40))
    true = true_vehicles(NOMINAL, RANGES, TYRES, few, seed=3)
    v = np.linspace(3.0, 45.0, 40)
    A, B, E = true.matrices(v, convention)
    steady = true.steady_state(v, convention)
    for i in range(40):
        own = {name: float(getattr(true, name)[i]) for name in NAMES[:4]}
        model = BicycleModel(VehicleParameters(**own, l_f=NOMINAL.l_f, l_r=NOMINAL.l_r), convention)
        for ours, theirs in zip((A[i], B[i], E[i]), model.matrices(v[i]), strict=True):
            np.testing.assert_array_equal(ours, theirs[0])
        assert steady.delta[i] == model.steady_state(v[i]).delta[0]
        assert steady.e_psi[i] == model.steady_state(v[i]).e_psi[0]


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="seed: -1; allowed"):
        true_vehicles(NOMINAL, Mismatch(), Tyres(), MANY, seed=-1)
    true = true_vehicles(NOMINAL, RANGES, TYRES, MANY.take(slice(2)), seed=3)
    with pytest.raises(InputError, match=r"v\[1\] = 0 m/s; allowed: finite speeds > 0"):
        true.matrices([20.0, 0.0], "consistent")
