"""Warnings about small samples and left-out references."""

import dataclasses

import numpy as np
import pytest

from studies.ranking.inference import Inference, infer
from studies.ranking.ranking import warnings_of_sample


@pytest.fixture
def inference() -> Inference:
    S = np.random.default_rng(1).gamma(2.0, 1.0, (3, 20))
    return infer(S, np.repeat([1, -1], 10), ranked=3, baseline=None, seed=0, samples=50, confidence=0.95)


@pytest.mark.parametrize(
    ("left", "right", "words"),
    [
        (25, 24, "too short with so few scenarios (25 left and 24 right)"),
        (91, 9, "too short with so few scenarios (91 left and 9 right)"),
        (0, 49, "too short with so few scenarios (49 right)"),
        (99, 1, "no interval and no designs are separated: a side has one scenario only (99 left and 1 right)"),
        (40, 10, ""),
        (50, 0, ""),
    ],
)
def test_small_samples_are_told(inference: Inference, left: int, right: int, words: str) -> None:
    found = list(warnings_of_sample(np.repeat([1, -1], [left, right]), inference))
    assert len(found) == bool(words)
    assert all(words in text for text in found)
    if "too short" in words:
        assert found[0].endswith("None of them counts the sampling error of the scenario model itself.")


def test_left_out_references_are_told(inference: Inference) -> None:
    side = np.repeat([1, -1], 30)
    assert not list(warnings_of_sample(side, inference))
    (text,) = warnings_of_sample(side, dataclasses.replace(inference, references=20, may_be_best=600))
    assert "from 20 of 600 designs that may be the best" in text
