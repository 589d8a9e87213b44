"""Errors as data: fields that travel, and a page of the sentences that they make."""

import math
import pickle
from typing import Any

import pytest

from ldctoolkit.errors import InputError, LdcError, StudyError, UnknownNameError
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.studies.extraction import NothingReadError

SENTENCES = [
    ({"path": "lqr.r_delta", "value": -1.0, "allowed": "a number > 0"}, "lqr.r_delta: -1.0; allowed: a number > 0"),
    (
        {"path": "side", "value": "rihgt", "allowed": ("left", "right")},
        "side: 'rihgt'; did you mean 'right'? (allowed: left, right)",
    ),
    (
        {"path": "s.toml: gains.lqr.r", "problem": "no such gain", "allowed": ["r_delta", "q_y"]},
        "s.toml: gains.lqr.r: no such gain; allowed: q_y, r_delta",
    ),
    (
        {"path": "design", "value": "lq", "allowed": [f"law{i}" for i in range(99)], "listing": "ldc controllers"},
        "design: 'lq'; allowed: ldc controllers",
    ),
    ({"path": "lane.width", "allowed": ("dt", "offset")}, "lane.width: allowed: dt, offset"),  # far from both
    ({"path": "a.csv: line 3", "problem": "is cut short"}, "a.csv: line 3: is cut short"),
    ({"path": "X", "value": math.nan, "problem": "in row 3", "hint": "drop it"}, "X: nan in row 3; drop it"),
    ({"problem": "no design has results"}, "no design has results"),
]


@pytest.mark.parametrize(("fields", "sentence"), SENTENCES)
def test_the_sentence_is_made_of_the_fields(fields: dict[str, Any], sentence: str) -> None:
    assert str(InputError(**fields)) == sentence


def test_an_error_moves_with_its_fields() -> None:
    error = InputError("[2].K", value=[1, 3], allowed="one number", hint="write K = 1")
    moved = StudyError.of(error).within("gains").within("s.toml", ": ").hinted("see ldc init")
    assert (type(moved), moved.path, moved.value) == (StudyError, "s.toml: gains[2].K", [1, 3])
    assert (moved.allowed, moved.hint) == ("one number", "write K = 1; see ldc init")
    assert (error.path, error.hint) == ("[2].K", "write K = 1")
    assert InputError(value=3).within("gains").path == "gains"


@pytest.mark.parametrize("value", [3, "x", None, (1, 3), lambda: None])
def test_an_error_travels_between_processes(value: Any) -> None:
    error = UnknownNameError(
        "law", "is not a known control law", value=value, allowed={"lqr": 1, "pid": 3}.keys(), hint="h"
    )
    there = pickle.loads(pickle.dumps(error))
    assert (type(there), str(there), there.allowed) == (UnknownNameError, str(error), ("lqr", "pid"))
    assert repr(there.value) == repr(value)


def test_an_error_with_arguments_of_its_own_travels_and_moves() -> None:
    error = NothingReadError((Problem("a.csv", "line 1", "is empty"),))
    for other in (pickle.loads(pickle.dumps(error)), error.within("trips", ": ")):
        assert isinstance(other, NothingReadError)
        assert (other.problem, other.problems) == (error.problem, error.problems)


def test_every_error_is_of_the_family() -> None:
    assert issubclass(UnknownNameError, KeyError)
    with pytest.raises(LdcError, match=r"^x: 1$"):
        raise UnknownNameError("x", value=1)  # KeyError itself would print a representation
