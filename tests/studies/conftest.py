"""Fixtures for the tests of studies: a small study, controllers that exist only in a test."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.closed_loop import Unsighted, known
from ldctoolkit import Controller, EventStatus, LinearLaw, Plant, gain, option
from ldctoolkit.studies import Study, run_study


@dataclasses.dataclass(frozen=True)
class Toy(Controller):
    name = "toy"
    title = "Toy"

    K: float = gain(-0.2, unit="rad/rad", lower=-1.0, upper=0.0, description="a number")
    N: int = gain(5, unit="samples", lower=1, upper=50, scale="log", description="a whole number")
    on: bool = gain(True, unit="1", description="a truth value")
    convention: str = option("consistent", choices=("consistent", "as_printed"), description="a reading")

    def prepare(self, plant: Plant) -> LinearLaw:
        n = plant.n
        sign = 1.0 if self.convention == "consistent" else 0.5
        F = np.tile([-0.01, 0.0, sign * self.K, 0.0], (n, 1))
        return LinearLaw(F, np.zeros(0), np.zeros((n, 0)), np.zeros((n, 0)), np.zeros(n))


@dataclasses.dataclass(frozen=True)
class Boom(Controller):
    name = "boom"
    title = "Boom"

    K: float = gain(0.0, unit="1", lower=0.0, upper=9.0, description="raises above 1")

    def prepare(self, plant: Plant) -> LinearLaw:
        if self.K > 1:
            raise ZeroDivisionError(f"K is {self.K}")
        return Toy().prepare(plant)


@dataclasses.dataclass(frozen=True)
class FailingLaw(Unsighted):
    def step(self, t: Any, x: Any, preview: Any, delta_prev: Any, state: Any) -> Any:
        status = np.where(np.arange(t.size) % 2 == 0, EventStatus.SOLVER_FAILED, EventStatus.OK).astype(np.int8)
        return np.zeros(t.size), state, status


@dataclasses.dataclass(frozen=True)
class Failing(Controller):
    name = "failing"
    title = "Failing"

    def prepare(self, plant: Plant) -> FailingLaw:
        return FailingLaw()


@pytest.fixture
def laws() -> Iterator[None]:
    """Laws that are known during one test only."""
    with known(Toy, Boom, Failing):
        yield


def small_study(**parts: Any) -> Study:
    """A small study; keyword arguments replace its parts."""
    content: dict[str, Any] = {
        "name": "small",
        "seed": 3,
        "scenarios": {"left": 7, "right": 5},
        "ranking": {"bootstrap": 200, "finalists": 0},
        "design": [
            {"law": "none"},
            {"law": "preview_proportional", "y_s": [0.05, 0.2], "gains": {"K_y": [-0.02, -0.005]}},
            {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": [50, 500]}},
        ],
    }
    return Study.from_dict(content | parts)


@pytest.fixture
def make_study() -> Callable[..., Study]:
    """`small_study`."""
    return small_study


@pytest.fixture(scope="session")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the small study, run once a session; tests only read it."""
    folder = tmp_path_factory.mktemp("small") / "run"
    run_study(small_study(), directory=folder, workers=1, progress=False)
    return folder


@pytest.fixture
def stored_rows() -> Callable[..., Any]:
    """All rows that a study's folder holds, in one order; none may be there twice."""

    def rows(folder: Path, *parts: str) -> Any:
        import polars as pl

        table = pl.read_parquet(folder.joinpath(*parts) / "results" / "part-*.parquet")
        key = ["design", "scenario"]
        assert table.select(key).n_unique() == table.height, f"{folder}: rows are there twice"
        return table.sort(key)

    return rows
