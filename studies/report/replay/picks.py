"""Which departures and which designs are driven again, by a stated rule."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit import Controller, EventStatus
from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.departures import LEFT, RIGHT
from studies.paper_design import PAPER_LAW
from studies.report.context import Context
from studies.report.replay.asked import asked_departures, asked_designs
from studies.report.tables.row import Row, is_baseline
from studies.report.tables.worst_departures import NAMED, worst_first
from studies.results import FAILED_STATUSES

SIDE_NAMES = {LEFT: "Left", RIGHT: "Right"}
MOST_LAWS = 8
"""Laws whose best designs are driven again."""
MOST_DESIGNS = 12
"""Designs that finalists and the Pareto front fill up."""

_GOLDEN = 0.6180339887498949
"""Multiples of it, without their whole parts, are spread evenly wherever they are cut off."""

FINALIST, PARETO = "finalist", "on the Pareto front"
PAPER = "the paper\u2019s Table I"
REDUCTIONS = ("least reduction", "median reduction", "greatest reduction")
STATUS_WORDS = {
    EventStatus.OK: "driven to the end",
    EventStatus.NEVER_TRIGGERED: "never took over",
    EventStatus.SOLVER_FAILED: "a solve failed, the fallback steered",
    EventStatus.DIVERGED: "left the bound of the simulation",
    EventStatus.TIMED_OUT: "ended by the time limit",
    EventStatus.INVALID: "cannot be driven",
    EventStatus.CRASHED: "the law crashed",
    EventStatus.BEYOND_DELTA_MAX: "taken over beyond delta_max, driven to the end",
}
"""What became of a departure, for people."""


@dataclasses.dataclass(frozen=True)
class Pick:
    """One departure that is driven again.

    Attributes
    ----------
    row : int
        Which scenario of the study's drivable ones.
    roles : tuple of str
        Why; empty for those that are spread over S.
    """

    row: int
    roles: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Chosen:
    """One design that is driven again.

    Attributes
    ----------
    row : Row
    why : str
        Winner, second of the ranking, best of its law, baseline, Table I, that it was asked for, finalist or Pareto.
    """

    row: Row
    why: str

    @property
    def further(self) -> bool:
        """Whether it is there only as long as there is room."""
        return self.why in (FINALIST, PARETO)


def most_departures(chosen: Chosen) -> int | None:
    """On how many departures a law is driven again; None for all: those that take long say so by a small batch."""
    return chosen.row.design.batch if chosen.row.design.batch < Controller.batch else None


def chosen_designs(context: Context) -> tuple[Chosen, ...]:
    """The best, the second, the best of each law, the baseline, Table I and those asked for; no control is none.

    Finalists and then the Pareto front, by rank, fill up to `MOST_DESIGNS`, unless they take long. The first one is the
    one that departures are chosen by.
    """
    table = context.primary
    by_index = {row.index: row for row in table.rows}
    asked = asked_designs(context.report.results.designs, context.report.shown_designs)
    first, *others = table.best_of_each_law[:MOST_LAWS]  # the first one is the best
    second = [row for row in table.rows if row is not table.best][:1]
    reasons = (
        (table.best_name.removeprefix("the "), (first,)),
        ("second of the ranking", second),
        ("best of its law", (*others, table.best_of(PAPER_LAW))),
        ("baseline", (table.baseline,)),
        (PAPER, (table.paper_design,)),
        ("asked for", (by_index[i] for i in asked if i in by_index)),
    )
    kept: dict[int, Chosen] = {}
    for why, rows in reasons:
        for row in rows:
            if row is not None and not is_baseline(row):
                kept.setdefault(row.index, Chosen(row, why))
    finalists = (Chosen(row, FINALIST) for row in table.rows if row.fresh is not None)
    pareto = (Chosen(row, PARETO) for row in table.rows if row.pareto)
    for one in (*finalists, *pareto):
        if len(kept) < MOST_DESIGNS and not is_baseline(one.row) and most_departures(one) is None:
            kept.setdefault(one.row.index, one)
    return tuple(kept.values())


def reductions(context: Context, index: int) -> FloatArray:
    """1 - S/S_uncorrected of a design per departure, (n,); 0 where there is nothing to reduce."""
    S, S_0 = context.case.S[index], context.case.S_uncorrected[index]
    result: FloatArray = 1.0 - np.divide(S, S_0, out=np.ones_like(S), where=S_0 > 0)
    return result


def picked_departures(context: Context, designs: tuple[Chosen, ...], count: int) -> tuple[Pick, ...]:
    """Departures asked for, then those with a name, then others evenly over the ranks of S, about `count` in all.

    Parameters
    ----------
    context : Context
    designs : tuple of Chosen
        At least one; the first one's scores decide.
    count : int
        All where the study has fewer.

    Returns
    -------
    tuple of Pick
        Each departure once, in the order of their weight.
    """
    n = context.scenarios.n
    roles: dict[int, list[str]] = {}
    for row in asked_departures(context.scenarios, context.report.departures):
        roles[row] = ["asked for"]
    for row, role in (*_named(context, designs[0].row), *_worst(context, designs[0].row), *_failures(context, designs)):
        roles.setdefault(row, []).append(role)
    S = context.S(designs[0].row)
    order, room = np.argsort(S, kind="stable"), max(count - len(roles), 0)
    ranks = np.arange(n) if n <= count else np.unique(np.rint(np.linspace(0, n - 1, room)).astype(np.int64))
    ranks = ranks[np.argsort((np.arange(ranks.size) * _GOLDEN) % 1.0, kind="stable")]
    for row in order[ranks].tolist():
        roles.setdefault(row, [])
    return tuple(Pick(row, tuple(said)) for row, said in roles.items())


def _named(context: Context, row: Row) -> list[tuple[int, str]]:
    case, side = context.case, context.scenarios.side
    S, reduction = context.S(row), reductions(context, row.index)
    deepest, a_y = case.companions.deepest[row.index], case.companions.a_y_peak[row.index]
    took_over = case.status[row.index] != EventStatus.NEVER_TRIGGERED
    found = []
    for some in (np.flatnonzero(side == one) for one in (LEFT, RIGHT)):
        if not some.size:
            continue
        order = some[np.argsort(S[some], kind="stable")]
        found += [(_first_largest(S, some), "worst S"), (int(order[(order.size - 1) // 2]), "median S")]
        found += [(int(order[0]), "best S")]
        found += choose(reduction, some[took_over[some]])
        found += [(_first_largest(deepest, some), "deepest")]
        found += [(_first_largest(a_y, some), "largest lateral acceleration")]
    return found


def _worst(context: Context, row: Row) -> list[tuple[int, str]]:
    """Those that the section on failures names."""
    return [(int(k), f"largest S, no. {i} of all") for i, k in enumerate(worst_first(context.S(row))[:NAMED], start=1)]


def _first_largest(values: npt.NDArray[np.floating], some: IntArray) -> int:
    return int(some[np.argmax(np.where(np.isnan(values[some]), -np.inf, values[some]))])


def _failures(context: Context, designs: tuple[Chosen, ...]) -> list[tuple[int, str]]:
    """The first departure with each kind of failure, and of which design."""
    found = []
    for status in FAILED_STATUSES:
        for chosen in designs:
            rows = np.flatnonzero(context.case.status[chosen.row.index] == status)
            if rows.size:
                found.append((int(rows[0]), f"{STATUS_WORDS[status]} ({chosen.row.title})"))
                break
    return found


def choose(reduction: FloatArray, candidates: IntArray) -> list[tuple[int, str]]:
    """Candidates with the least, the median and the greatest reduction; on a tie the earliest; each scenario once.

    Examples
    --------
    >>> choose(np.array([0.3, 0.1, 0.2]), np.array([0, 1, 2]))
    [(1, 'least reduction'), (2, 'median reduction'), (0, 'greatest reduction')]
    """
    if not candidates.size:
        return []
    order = candidates[np.argsort(reduction[candidates], kind="stable")]
    greatest = int(candidates[np.argmax(reduction[candidates])])
    chosen = [int(order[0]), int(order[(order.size - 1) // 2]), greatest]
    first = dict(reversed(list(zip(chosen, REDUCTIONS, strict=True))))
    return [(row, first[row]) for row in dict.fromkeys(chosen)]
