"""The ranking of a study: designs by mean S, with what the scenarios allow to say of them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, IntArray
from ldctoolkit.review import design_margins
from studies.design import Design
from studies.ranking.baseline import find_baseline
from studies.ranking.case_figures import CaseFigures, DrivableCase, Margins, case_figures, in_order
from studies.ranking.failed_commands import warnings_of
from studies.ranking.few_scenarios import warnings_of_sample
from studies.ranking.fresh_scores import FreshScores, SearchScores, fresh_case, fresh_scores, no_fresh_scores
from studies.ranking.inference import Inference, infer
from studies.ranking.pareto import pareto_costs, pareto_front
from studies.ranking.requirements import SETS, Miss, Requirement, metric, missed_by, requirements_of
from studies.results import Case, CaseResults, FailedDesign, StudyResults
from studies.study_file.spec import Study

if TYPE_CHECKING:
    from ldctoolkit import Setup

SCORE: Final = (
    "S is the integral over time of |e_y|, the distance of the vehicle's centre from the lane's centre: less is better"
)
"""What every score means; no full stop, the window may follow."""

MARGIN_SPEEDS: Final = tuple(range(10, 41, 5))
"""Speeds [m/s] that the margins of a design are the smallest of."""


@dataclasses.dataclass(frozen=True, repr=False)
class Ranking(CaseFigures, Inference, FreshScores):
    """Designs of one case, best first; every array has one entry a design in that order.

    Beside the fields below it has those of `CaseFigures` (means, tails, reductions, shares, counts and `release`), of
    `Inference` (intervals, set of best) and of `FreshScores` (the finalists and the winner).

    Attributes
    ----------
    case : Case
        Window and convention.
    designs : tuple of Design
        d designs: those that meet all requirements, smallest mean S first, equal ones in the study's order; then the
        others in the same way.
    index : (d,) int
        Position of each in `StudyResults.designs`.
    rank : (d,) int
        1 for the best; designs with the same mean S share a rank. 0 for a design that misses a requirement: it is not
        ranked.
    missed : tuple of tuple of Miss
        For each design, the requirements that it misses, and its values.
    requirements : tuple of Requirement
    limits : tuple of Requirement
        The requirements, and behind them those of the sets ``stable``, ``comfort`` and ``physical``.
    baseline : int or None
        Position of the design behind `baseline_difference`.
    pareto : (d,) bool
        Ranked designs that no other ranked design beats in one figure of `pareto_figures` without being worse in
        another.
    pareto_figures : tuple of str
    scenarios : int
        Study scenarios that could be driven under every design.
    D_y : float [m]
    bootstrap : int
        Resamples.
    confidence : float
        Of every family of intervals, and of the set of best.
    warnings : tuple of str
        What a reader must know before comparing designs.
    failed : tuple of FailedDesign
        Designs whose law failed: they have no rank and no figures.
    given_up : int
        Designs that a race gave up before: they have no rank and no figures either.
    raced : bool
        Whether that race was run by this case's S. If not, `set_of_best` and the other comparisons are of the survivors
        of another race only, and there is no winner.
    """

    case: Case
    designs: tuple[Design, ...]
    index: IntArray
    rank: IntArray
    missed: tuple[tuple[Miss, ...], ...]
    requirements: tuple[Requirement, ...]
    limits: tuple[Requirement, ...]
    baseline: int | None
    pareto: BoolArray
    pareto_figures: tuple[str, ...]
    scenarios: int
    D_y: float
    bootstrap: int
    confidence: float
    warnings: tuple[str, ...]
    failed: tuple[FailedDesign, ...] = ()
    given_up: int = 0
    raced: bool = True

    def __len__(self) -> int:
        return len(self.designs)

    def __repr__(self) -> str:
        best = f"best {self.designs[0].label!r}, mean S {self.S[0]:.4g} m s" if self.ranked else "none is ranked"
        return f"<Ranking of {len(self)} designs, {self.case.label}: {best}>"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        from studies.ranking.ranking_text import ranking_html  # it is made from rankings

        return ranking_html(self)

    @property
    def ranked(self) -> int:
        """Number of designs that have a rank; they are the first ones."""
        return int((self.rank > 0).sum())

    @property
    def require(self) -> tuple[str, ...]:
        """The requirements as text."""
        return tuple(one.text for one in self.requirements)

    @property
    def unmet(self) -> tuple[tuple[str, ...], ...]:
        """For each design, the requirements that it misses, as text."""
        return tuple(tuple(miss.requirement.text for miss in some) for some in self.missed)

    @property
    def survivors_only(self) -> bool:
        """Whether designs were given up by S of another case, which may have been the best of this one."""
        return self.given_up > 0 and not self.raced

    @classmethod
    def of(
        cls,
        results: StudyResults,
        case: CaseResults,
        *,
        seed: int = 0,
        bootstrap: int = 2000,
        confidence: float = 0.95,
        D_y: float = 0.5,
        baseline: str = "",
        require: Sequence[str] = (),
        pareto: Sequence[str] = (),
        setup: Setup | None = None,
    ) -> Ranking:
        """Rank the designs of one case.

        Parameters
        ----------
        results : StudyResults
            Designs and scenarios, and the finalists on fresh ones.
        case : CaseResults
            One of its cases.
        seed : int
            Of the bootstrap.
        bootstrap : int
            Resamples, drawn within each side; all designs see the same ones.
        confidence : float
            Of each family of simultaneous intervals, between 0 and 1.
        D_y : float [m]
            Depth that counts as deep.
        baseline : str
            As `studies.ranking.baseline.find_baseline` takes it.
        require : sequence of str
            Requirements and names of sets, as `studies.ranking.requirements.requirements_of` takes them.
        pareto : sequence of str
            Metrics of the Pareto front; none for no front.
        setup : Setup, optional
            What the designs were driven with: for their margins and the friction. Without it margins are NaN.

        Returns
        -------
        Ranking

        Raises
        ------
        InputError
            For settings outside what is allowed, a baseline that is not there, or scores that are not finite.
        UnknownNameError
            For a metric or set that does not exist.
        """
        options = None if setup is None else setup.options
        requirements = requirements_of(require, options)
        limits = requirements_of((*require, *(name for name in SETS if name != "lane-edge")), options)
        pareto_figures = tuple(metric(name).name for name in pareto)
        reference = find_baseline(baseline, results)
        drivable = DrivableCase.of(case, results.scenarios)
        margins = {} if setup is None else _margins(results.designs, setup.under(case.case.convention))
        figures = case_figures(drivable, results.designs, D_y, margins, setup)
        missed = missed_by(requirements, figures)
        order = np.lexsort((figures.S, np.array([bool(some) for some in missed]))).astype(np.int64)
        ranked = sum(not some for some in missed)
        taken = in_order(figures, order)
        chance: dict[str, Any] = {"seed": seed, "samples": bootstrap, "confidence": confidence}
        position = None if reference is None else _position(order, reference)
        inference = infer(
            drivable.counted,
            drivable.scenarios.side,
            ranked=ranked,
            baseline=position,
            rows=order,
            **chance,
        )
        warnings = list(_warnings(drivable, results.designs))
        if (np.isnan(figures.release.a_y_added_peak_mean) & np.isfinite(figures.release.a_y_peak_mean)).any():
            warnings.append(_NOT_RECORDED)
        designs = tuple(results.designs[i] for i in order)
        fresh = no_fresh_scores(len(order), ranked)
        if results.fresh is not None and results.fresh.designs:
            again, place = fresh_case(results.fresh, case.case), {design.id: k for k, design in enumerate(designs)}
            search = SearchScores(
                drivable.counted,
                order,
                drivable.scenarios.side,
                inference.set_of_best,
                ranked,
                position,
                paired=position is not None and not designs[position].is_baseline,
            )
            fresh = fresh_scores(
                again,
                np.array([place[design.id] for design in results.fresh.designs], dtype=np.int64),
                search,
                [
                    tuple(miss.requirement.text for miss in some)
                    for some in missed_by(requirements, case_figures(again, results.fresh.designs, D_y, margins, setup))
                ],
                first_failed=designs[0] in [one.design for one in results.fresh.failed],
                **chance,
            )
            warnings += _about_finalists(fresh, ranked)
        given_up = 0 if results.race is None else len(results.race.dropped)
        raced = case.case == results.cases[0].case
        if given_up and not raced:
            fresh = dataclasses.replace(fresh, winner=None)
            warnings.append(_not_raced(results, given_up))
        acting = [i for i, design in enumerate(designs) if not design.is_baseline]
        if requirements and acting and not any(i < ranked for i in acting):
            fresh = dataclasses.replace(fresh, winner=None)  # to leave the departures alone is no design
        warnings += warnings_of_sample(drivable.scenarios.side, inference)
        front = np.zeros(len(order), dtype=np.bool_)
        if pareto_figures and ranked:
            front[:ranked] = pareto_front(pareto_costs(pareto_figures, figures)[order[:ranked]])
        S = taken["S"][:ranked]
        rank = np.zeros(len(order), dtype=np.int64)
        rank[:ranked] = np.searchsorted(S, S, side="left") + 1
        return cls(
            **taken,
            **_fields(inference),
            **_fields(fresh),
            case=case.case,
            designs=designs,
            index=order,
            rank=rank,
            missed=tuple(missed[i] for i in order),
            requirements=requirements,
            limits=limits,
            baseline=position,
            pareto=front,
            pareto_figures=pareto_figures,
            scenarios=len(drivable.scenarios),
            D_y=D_y,
            bootstrap=bootstrap,
            confidence=confidence,
            warnings=tuple(warnings),
            failed=results.failed,
            given_up=given_up,
            raced=raced,
        )

    def best_of_each_law(self) -> tuple[int, ...]:
        """Positions of the best design of every law, best law first."""
        first: dict[str, int] = {}
        for i, design in enumerate(self.designs):
            first.setdefault(design.law, i)
        return tuple(first.values())


def rank_study(results: StudyResults, study: Study) -> tuple[Ranking, ...]:
    """Rank every case of a study with the study's own settings.

    Parameters
    ----------
    results : StudyResults
    study : Study

    Returns
    -------
    tuple of Ranking
        In the order of the cases; the first is the primary one.
    """
    settings = study.ranking
    return tuple(
        Ranking.of(
            results,
            case,
            seed=study.seed,
            bootstrap=settings.bootstrap,
            confidence=settings.confidence,
            D_y=study.report.D_y,
            baseline=settings.baseline,
            require=settings.require,
            pareto=settings.pareto,
            setup=study.setup(),
        )
        for case in results.cases
    )


def _margins(designs: Sequence[Design], setup: Setup) -> Margins:
    """Margins of every design; they do not depend on its threshold."""
    same: dict[tuple[Any, ...], list[Design]] = {}
    for design in designs:
        same.setdefault((design.law, design.gains), []).append(design)
    return {design.id: pair for key, pair in _margins_of(tuple(same), setup).items() for design in same[key]}


@functools.lru_cache(maxsize=8)
def _margins_of(keys: tuple[tuple[Any, ...], ...], setup: Setup) -> dict[tuple[Any, ...], tuple[float, float]]:
    """Margins of laws with their gains: a run ranks more than once."""
    controllers = [Design(law, 0.2, gains).controller(setup.convention) for law, gains in keys]
    gain, phase = design_margins(controllers, setup, MARGIN_SPEEDS)
    return dict(zip(keys, zip(gain.min(axis=1).tolist(), phase.min(axis=1).tolist(), strict=True), strict=True))


_NOT_RECORDED = (
    "Added peaks of lateral acceleration and jerk are not recorded in these results, which an earlier version stored: "
    "how many interventions are comfortable is not known. Run the study into another folder to have them."
)


def _fields(part: Inference | FreshScores) -> dict[str, Any]:
    return {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}


def _position(order: IntArray, index: int) -> int:
    return int(np.flatnonzero(order == index)[0])


def _about_finalists(fresh: FreshScores, ranked: int) -> Iterator[str]:
    """Finalists that were better by the search but miss a requirement on the fresh scenarios."""
    if not ranked:
        return
    if fresh.winner is None:
        texts = " or ".join(dict.fromkeys(text for texts in fresh.fresh_unmet for text in texts))
        yield (
            f"No finalist meets the requirements on the fresh scenarios (each misses {texts}): there is no winner. "
            "Ask for more finalists, or leave a margin in the requirements."
        )
        return
    for i, missed in enumerate(fresh.fresh_unmet[: fresh.winner]):
        if missed:
            yield f"Design # {i + 1} misses {', '.join(missed)} on the fresh scenarios and is not the winner."


def _not_raced(results: StudyResults, given_up: int) -> str:
    return (
        f"This case was not raced: {given_up} of {given_up + len(results.designs)} designs were given up by S of "
        f"{results.cases[0].case.label}, and one of them may be the best here. Ranks, differences and the set of best "
        "are of the survivors only, and there is no winner; run the study without a race to rank this case."
    )


def _warnings(drivable: DrivableCase, designs: Sequence[Design]) -> Iterator[str]:
    case = drivable.case
    if drivable.left_out:
        yield (
            f"{drivable.left_out} of {drivable.status.shape[1]} scenarios cannot be driven (a parameter is not finite "
            "or has the wrong sign, or the speed leaves 1 to 90 m/s); no metric of any design counts them."
        )
    if case.case.window == "control" and len({design.y_s for design in designs}) > 1:
        yield (
            "S over the control window starts at the trigger, which moves with y_s: a later trigger gives a smaller S. "
            "Designs with different y_s are not comparable here; use the departure window."
        )
    yield from warnings_of(case, designs)
