"""The ranking of a study: designs by mean S, with what the scenarios allow to say of them."""

from __future__ import annotations

import dataclasses
import html
import re
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, IntArray
from ldctoolkit.notebook import CELL
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

SCORE: Final = (
    "S is the integral over time of |e_y|, the distance of the vehicle's centre from the lane's centre: less is better"
)
"""What every score means; no full stop, the window may follow."""

TOP: Final = 20
"""Rows; the winner and the baseline follow where they are further down."""

_BAR: Final = 120
"""Width of the interval bars [px]."""

_LEFT: Final = f"text-align:left;{CELL}"
_RIGHT: Final = f"text-align:right;white-space:nowrap;{CELL}"

_MINUS: Final = re.compile(r"(?<![\w.])-(?=\d)")


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
        if (np.isnan(figures.release.a_y_added_peak_mean) & np.isfinite(figures.release.a_y_peak_mean)).any():
            warnings.append(_NOT_RECORDED)
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


_NOT_RECORDED = (
    "Added peaks of lateral acceleration and jerk are not recorded in these results, which an earlier version stored: "
    "how many interventions are comfortable is not known. Run the study into another folder to have them."
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


def ranking_sentences(ranking: Ranking) -> Iterator[str]:
    """The winner and its score, its gain over no control and over the baseline, the set of best, what is not ranked.

    Parameters
    ----------
    ranking : Ranking

    Yields
    ------
    str
        Plain text, not escaped; it holds titles of laws.
    """
    yield _winner(ranking)
    if ranking.winner is not None:
        yield from _gains(ranking, ranking.winner)
    yield from _set_of_best(ranking)
    if ranking.ranked < len(ranking):
        left = len(ranking) - ranking.ranked
        yield f"{_count(left, 'design')} of {len(ranking):,} not ranked: a requirement is missed."
    if ranking.failed:
        yield f"{_count(len(ranking.failed), 'design')} failed, without figures."
    if ranking.given_up:
        yield f"{_count(ranking.given_up, 'design')} given up in a race before."


def failures(ranking: Ranking, place: int) -> int:
    """Scenarios of a design in which its law did not do its work."""
    counts = (ranking.solver_failed, ranking.diverged, ranking.timed_out, ranking.crashed)
    return sum(int(count[place]) for count in counts)


def marks(ranking: Ranking, place: int) -> tuple[str, ...]:
    """What a design is called beside its rank: winner, set of best, Pareto, baseline, and what it misses."""
    found = []
    if place == ranking.winner:
        found.append("winner")
    elif ranking.set_of_best[place]:
        found.append("set of best")
    if ranking.pareto[place]:
        found.append("Pareto")
    if place == ranking.baseline:
        found.append("baseline")
    return (*found, *(f"misses {text}" for text in ranking.unmet[place]))


def _winner(ranking: Ranking) -> str:
    i, level = ranking.winner, f"{100.0 * ranking.confidence:g} % interval"
    if i is None:
        if not ranking.ranked:
            return "No design meets the requirements: none is ranked and none wins."
        if ranking.survivors_only:
            return "There is no winner: this case was not raced, and the best design may have been given up."
        return "There is no winner: no finalist meets the requirements on the fresh scenarios."
    label = ranking.designs[i].label
    if np.isfinite(ranking.fresh_S[i]):
        return (
            f"Winner: {label}, mean S {ranking.fresh_S[i]:.4f} m s on {ranking.fresh_scenarios:,} fresh scenarios "
            f"({level} {ranking.fresh_low[i]:.4f} to {ranking.fresh_high[i]:.4f})."
        )
    between = f" ({level} {ranking.S_low[i]:.4f} to {ranking.S_high[i]:.4f})" if np.isfinite(ranking.S_low[i]) else ""
    return f"Winner: {label}, mean S {ranking.S[i]:.4f} m s{between}."


def _gains(ranking: Ranking, i: int) -> Iterator[str]:
    b, fresh_share = ranking.baseline, float(ranking.fresh_reduction[i])
    known = b is not None and b != i and np.isfinite(fresh_share)
    if b is not None and known:
        other = "no control" if ranking.designs[b].is_baseline else ranking.designs[b].label
        yield f"On the same scenarios that is {_change(fresh_share)} than {other} ({ranking.fresh_S[b]:.4f} m s)."
    share = float(ranking.reduction[i])
    told = b is not None and known and ranking.designs[b].is_baseline
    if np.isfinite(share) and not told and not ranking.designs[i].is_baseline:
        if np.isfinite(ranking.fresh_S[i]):
            yield (
                f"On the scenarios that designs were chosen on it has mean S {ranking.S[i]:.4f} m s, {_change(share)} "
                f"than no control ({ranking.S_uncorrected[i]:.4f} m s)."
            )
        else:
            yield f"That is {_change(share)} than no control ({ranking.S_uncorrected[i]:.4f} m s)."
    if b is None or b == i:
        return
    fresh = bool(np.isfinite(ranking.fresh_baseline_difference[i]))
    name = "fresh_baseline_difference" if fresh else "baseline_difference"
    value, low, high = (float(getattr(ranking, name + end)[i]) for end in ("", "_low", "_high"))
    if np.isfinite(low):
        where = "on the fresh scenarios" if fresh else "for all designs at once"
        yield (
            f"Difference to the baseline, {ranking.designs[b].label}: {value:+.4f} m s (interval {low:+.4f} to "
            f"{high:+.4f}, {where})."
        )


def _set_of_best(ranking: Ranking) -> Iterator[str]:
    size = int(ranking.set_of_best.sum())
    if not ranking.ranked or ranking.survivors_only or len(ranking) == 1:
        return
    level = f"{100.0 * ranking.confidence:g} % confidence"
    if size > 1:
        yield f"Set of best: {size:,} designs, which these scenarios do not tell apart; it holds the best with {level}."
    else:
        yield f"Set of best: one design; with {level} no other ranked design is better."


def _change(reduction: float) -> str:
    return f"{100.0 * abs(reduction):.1f} % {'less' if reduction >= 0 else 'more'}"


def _count(number: int, one: str) -> str:
    return f"{number:,} {one}{'' if number == 1 else 's'}"


def ranking_html(ranking: Ranking, top: int = TOP) -> str:
    """A ranking as HTML without script.

    Parameters
    ----------
    ranking : Ranking
    top : int
        Rows.

    Returns
    -------
    str
        Everything in it is escaped.
    """
    places = list(range(min(top, len(ranking))))
    places += sorted({p for p in (ranking.winner, ranking.baseline) if p is not None and p >= len(places)})
    title = f"{len(ranking):,} design{'' if len(ranking) == 1 else 's'} by mean S, {ranking.case.label}"
    said = "<br>".join(html.escape(_MINUS.sub("\u2212", sentence)) for sentence in ranking_sentences(ranking))
    warnings = "".join(f"<br><b>Warning:</b> {html.escape(text)}" for text in ranking.warnings)
    level = f"{100 * ranking.confidence:g} % interval"
    headings = "".join(
        f'<th scope="col" style="{style}">{html.escape(text)}</th>'
        for text, style in (
            ("rank", _RIGHT),
            ("design", _LEFT),
            ("mean S [m s]", _RIGHT),
            (level, _LEFT),
            ("to the best [m s]", _RIGHT),
            ("reduction", _RIGHT),
            ("failed", _RIGHT),
            ("", _LEFT),
        )
    )
    most = _right_end(ranking, places)
    rows = "".join(_row(ranking, place, most) for place in places)
    more = len(ranking) - len(places)
    foot = f"<div>and {more:,} more</div>" if more > 0 else ""
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(title)}</b><br>{said}{warnings}</div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><thead><tr>{headings}</tr></thead>'
        f"<tbody>{rows}</tbody></table>{foot}</div>"
    )


def _right_end(ranking: Ranking, places: list[int]) -> float:
    ends = np.concatenate([ranking.S[places], ranking.S_high[places]])
    ends = ends[np.isfinite(ends)]
    return max(float(ends.max()), 1e-12) if ends.size else 1.0


def _row(ranking: Ranking, i: int, most: float) -> str:
    away = "–" if i == 0 else f"{ranking.difference[i]:+.4f}".replace("-", "\u2212")  # noqa: RUF001
    weight = ";font-weight:bold" if i == ranking.winner else ""
    cells = (
        (_RIGHT, str(ranking.rank[i]) if ranking.rank[i] else "–"),  # noqa: RUF001
        (_LEFT + weight, html.escape(ranking.designs[i].label)),
        (_RIGHT + weight, f"{ranking.S[i]:.4f}"),
        (
            f"{_LEFT};white-space:nowrap",
            _bar(float(ranking.S[i]), float(ranking.S_low[i]), float(ranking.S_high[i]), most),
        ),
        (_RIGHT, away),
        (_RIGHT, _percent(float(ranking.reduction[i]))),
        (_RIGHT, str(failures(ranking, i) or "–")),  # noqa: RUF001
        (_LEFT, html.escape(", ".join(marks(ranking, i)))),
    )
    return "<tr>" + "".join(f'<td style="{style}">{cell}</td>' for style, cell in cells) + "</tr>"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %".replace("-", "\u2212") if np.isfinite(share) else "–"  # noqa: RUF001


def _bar(value: float, low: float, high: float, most: float) -> str:
    """The interval as a line and the mean as a point, to the scale of all rows; the numbers are its title."""
    if not np.isfinite(low + high):
        return "–"  # noqa: RUF001
    left, right, at = (round(_BAR * min(max(one / most, 0.0), 1.0), 1) for one in (low, high, value))
    text = f"{low:.4f} to {high:.4f}".replace("-", "\u2212")
    width = max(round(right - left, 1), 1.0)
    line = f"position:absolute;top:6px;height:2px;left:{left:g}px;width:{width:g}px;background:currentColor"
    point = f"position:absolute;top:3px;width:3px;height:8px;left:{at - 1.5:g}px;background:#0072B2"
    return (
        f'<span title="{text}" style="display:inline-block;position:relative;width:{_BAR}px;height:14px;'
        f'border-bottom:1px solid rgba(128,128,128,.35)"><span style="{line}"></span>'
        f'<span style="{point}"></span></span> {text}'
    )
