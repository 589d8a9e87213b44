"""The ranking of a study: designs by mean S, with what the scenarios allow to say of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from studies.design import Design
from studies.ranking.baseline import find_baseline
from studies.ranking.case_figures import CaseFigures, DrivableCase, case_figures, in_order, missed_requirements
from studies.ranking.failed_commands import warnings_of
from studies.ranking.few_scenarios import warnings_of_sample
from studies.ranking.figures import Requirement, figure, parse_requirement
from studies.ranking.fresh_scores import FreshScores, SearchScores, fresh_case, fresh_scores, no_fresh_scores
from studies.ranking.inference import Inference, infer
from studies.ranking.pareto import pareto_costs, pareto_front
from studies.results import Case, CaseResults, FailedDesign, StudyResults
from studies.study_file.spec import Study

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


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
    unmet : tuple of tuple of str
        For each design, the requirements that it misses.
    require : tuple of str
        The requirements.
    baseline : int or None
        Position of the design behind `baseline_difference`.
    pareto : (d,) bool
        Ranked designs that no other ranked design beats in one figure of `pareto_figures` without being worse in
        another.
    pareto_figures : tuple of str
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
    unmet: tuple[tuple[str, ...], ...]
    require: tuple[str, ...]
    baseline: int | None
    pareto: BoolArray
    pareto_figures: tuple[str, ...]
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
        from studies.ranking.ranking_display import ranking_html

        return ranking_html(self)

    @property
    def ranked(self) -> int:
        """Number of designs that have a rank; they are the first ones."""
        return int((self.rank > 0).sum())

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
            Requirements, as `studies.ranking.figures.parse_requirement` takes them.
        pareto : sequence of str
            Figures of the Pareto front; none for no front.

        Returns
        -------
        Ranking

        Raises
        ------
        InputError
            For settings outside what is allowed, a baseline that is not there, or scores that are not finite.
        UnknownNameError
            For a figure that does not exist.
        """
        requirements = [parse_requirement(text) for text in require]
        pareto_figures = tuple(figure(name).name for name in pareto)
        reference = find_baseline(baseline, results)
        drivable = DrivableCase.of(case, results.scenarios)
        figures = case_figures(drivable, results.designs, D_y)
        missed = missed_requirements(requirements, figures)
        order = np.lexsort((figures.S, np.array([bool(texts) for texts in missed]))).astype(np.int64)
        ranked = sum(not texts for texts in missed)
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
        warnings += _about_requirements(requirements, ranked, len(order))
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
                missed_requirements(requirements, case_figures(again, results.fresh.designs, D_y)),
                first_failed=designs[0] in [one.design for one in results.fresh.failed],
                **chance,
            )
            warnings += _about_finalists(fresh, ranked)
        given_up = 0 if results.race is None else len(results.race.dropped)
        raced = case.case == results.cases[0].case
        if given_up and not raced:
            fresh = dataclasses.replace(fresh, winner=None)
            warnings.append(_not_raced(results, given_up))
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
            unmet=tuple(missed[i] for i in order),
            require=tuple(one.text for one in requirements),
            baseline=position,
            pareto=front,
            pareto_figures=pareto_figures,
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
        )
        for case in results.cases
    )


def _fields(part: Inference | FreshScores) -> dict[str, Any]:
    return {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}


def _position(order: IntArray, index: int) -> int:
    return int(np.flatnonzero(order == index)[0])


def _about_requirements(requirements: Sequence[Requirement], ranked: int, d: int) -> Iterator[str]:
    if requirements and not ranked:
        texts = " and ".join(one.text for one in requirements)
        yield (
            f"None of the {d} designs meets the requirements ({texts}): no design is ranked, and there is no winner. "
            "They are listed by mean S."
        )


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
            "or has the wrong sign, or the speed leaves 1 to 90 m/s); no figure of any design counts them."
        )
    if case.case.window == "control" and len({design.y_s for design in designs}) > 1:
        yield (
            "S over the control window starts at the trigger, which moves with y_s: a later trigger gives a smaller S. "
            "Designs with different y_s are not comparable here; use the departure window."
        )
    yield from warnings_of(case, designs)
