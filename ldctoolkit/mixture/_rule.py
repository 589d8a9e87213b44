"""Which K is taken: the smallest whose criterion is as good as the best, and a sentence that says so."""

from __future__ import annotations

import dataclasses
from typing import Final, Literal, get_args

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture.checks import check_number

Criterion = Literal["bic", "aic", "icl", "held_out"]

SLACK: Final[dict[str, float]] = {"bic": 10.0, "aic": 10.0, "icl": 10.0, "held_out": 1.0}
"""Default slack. Information criteria: 10 of their units, where Kass and Raftery (1995) begin to call a difference of
BIC very strong evidence, and Burnham and Anderson (2002) see no support left by AIC. Held out: one standard error."""


@dataclasses.dataclass(frozen=True)
class Rule:
    """The smallest K whose criterion lies within an allowance of the best.

    Attributes
    ----------
    criterion : {"bic", "aic", "icl", "held_out"}
        What is compared.
    slack : float
        The allowance, in units of the criterion; for "held_out" in standard errors of the paired difference.
    indifference : float
        The allowance where it is the larger one [nats per event].
    """

    criterion: Criterion
    slack: float
    indifference: float

    @classmethod
    def of(cls, criterion: str, slack: float | None, indifference: float) -> Rule:
        """The caller's wish, checked.

        Raises
        ------
        InputError
            For an unknown criterion, or an allowance that is not a number >= 0.
        """
        for known in get_args(Criterion):
            if criterion == known:
                break
        else:
            raise InputError(f"criterion: {criterion!r}; {nearest(str(criterion), get_args(Criterion))}")
        if slack is not None:
            check_number("slack", slack, 0.0)
        check_number("indifference", indifference, 0.0)
        return cls(known, SLACK[known] if slack is None else float(slack), float(indifference))

    def allowance(self, events: float, error: FloatArray) -> FloatArray:
        """How far from the best each K may be, (m,); `error` are the standard errors of the held-out differences."""
        if self.criterion == "held_out":
            return np.maximum(self.slack * error, self.indifference)
        return np.full(error.shape, max(self.slack, 2.0 * events * self.indifference))

    def reason(self, K: IntArray, loss: FloatArray, allowed: FloatArray, chosen: int, events: float) -> str:
        """One sentence: which K was taken, and why.

        Parameters
        ----------
        K : (m,)
            Numbers of components, ascending.
        loss : (m,)
            The criterion, lower is better.
        allowed : (m,)
            From `allowance`.
        chosen : int
            Index of the K that was taken.
        events : float
            n.
        """
        if K.size == 1:
            return f"K = {K[0]}, the only one there is"
        name = "held-out log-likelihood" if self.criterion == "held_out" else self.criterion.upper()
        best = least(loss)
        unit = 1.0 if self.criterion == "held_out" else 2.0 * events
        if self.indifference > 0.0 and allowed[chosen] == unit * self.indifference:
            within = f"{self.indifference:g} nats an event"
        elif self.criterion == "held_out":
            within = "one standard error" if self.slack == 1.0 else f"{self.slack:g} standard errors"
        else:
            within = f"{self.slack:g}"
        text = f"K = {K[chosen]}, the smallest whose {name} lies within {within} of the best"
        if best != chosen:
            gap = loss[chosen] - loss[best]
            size = f"{gap:.2g} nats an event" if self.criterion == "held_out" else f"{gap:.1f}"
            text += f" (K = {K[best]}, better by {size})"
        if best == K.size - 1:
            text += "; the best is the last one tried, so more components may be better still"
        return text


def least(loss: FloatArray) -> int:
    """Index of the least finite loss."""
    return int(np.argmin(np.where(np.isfinite(loss), loss, np.inf)))


def choose(loss: FloatArray, allowed: FloatArray) -> int:
    """Index of the first K whose loss lies within its allowance of the least.

    Parameters
    ----------
    loss : (m,)
        The criterion in ascending K, lower is better; one that is not finite is left out.
    allowed : (m,)
        How far each may lie from the least.

    Raises
    ------
    InputError
        If no criterion is finite.
    """
    usable = np.isfinite(loss)
    if not usable.any():
        raise InputError("components: no fit has a finite criterion; allowed: at least one")
    return int(np.argmax(usable & (loss <= loss[least(loss)] + allowed)))
