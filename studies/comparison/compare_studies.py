"""Two studies compared on the scenarios that they share: what got better, worse, or is not separated."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from studies.comparison.comparison import CaseComparison, Comparison
from studies.comparison.paired_verdicts import paired_differences
from studies.comparison.shared_scenarios import SharedScenarios, drawn_streams, share_scenarios
from studies.comparison.winners import FinishedStudy, compare_winners, held_designs, input_differences
from studies.design import Design
from studies.results import Case, CaseResults, FailedDesign, StudyResults

_FEW = 200
"""Shared scenarios below which intervals are rough."""

CasePairs = list[tuple[CaseResults, CaseResults]]


def compare(
    old: str | Path | FinishedStudy,
    new: str | Path | FinishedStudy,
    *,
    bootstrap: int | None = None,
    confidence: float | None = None,
) -> Comparison:
    """Compare two finished studies on the scenarios that they share.

    Parameters
    ----------
    old, new : path or FinishedStudy
        Folders of the studies.
    bootstrap : int, optional
        Resamples of the scenarios; the new study's by default.
    confidence : float, optional
        Of the intervals, all designs and cases together; the new study's by default.

    Returns
    -------
    Comparison
        Differences are new minus old, so that a negative one is an improvement.

    Raises
    ------
    StoreError
        If a folder holds no study, or one that is broken or not finished.
    InputError
        If the studies cannot be compared: the same folder twice, no scenario or no case in both.

    Notes
    -----
    Designs are matched by identifier: same law, gains and y_s. Each mean counts a failed scenario at least as bad as
    without control. What one study draws for a scenario and the other does not is part of what is compared; what both
    draw has to be the same draw.

    Examples
    --------
    >>> import tempfile
    >>> from studies import Study, compare, run_study
    >>> def study(m):
    ...     content = {"name": "small", "scenarios": {"left": 40, "right": 40}, "vehicle": {"m": m}}
    ...     return Study.from_dict(content | {"design": [{"law": "none"}, {"law": "lqr"}]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for m in (1000.0, 1300.0):
    ...         _ = run_study(study(m), directory=f"{folder}/{m:g}", workers=1)
    ...     comparison = compare(f"{folder}/1000", f"{folder}/1300")
    >>> comparison.differences
    ('vehicle.m: 1000.0 -> 1300.0',)
    >>> [str(verdict) for verdict in comparison.cases[0].S.verdict]
    ['same', 'worse']
    """
    before, after = _read_both(old, new)
    settings = after.study.ranking
    samples = settings.bootstrap if bootstrap is None else bootstrap
    level = settings.confidence if confidence is None else confidence
    differences = input_differences(before, after)
    pairs = _shared_cases(before, after)
    every = _shared_scenarios(before, after, differences)
    shared = _driven(every, before.results, after.results)
    if not shared.n:
        raise InputError(f"{before.source}, {after.source}: no shared scenario could be driven under every design")
    comparison = Comparison(
        old=before.source,
        new=after.source,
        old_name=before.study.name,
        new_name=after.study.name,
        differences=differences,
        shared=shared,
        cases=tuple(_cases(before, after, pairs, shared, samples, level)),
        only_old=_only(before.results, after.results),
        only_new=_only(after.results, before.results),
        new_failures=_failed(after.results, ran=before.results),
        repaired=_failed(before.results, ran=after.results),
        failed_in_both=_failed(after.results, failed=before.results),
        given_up=_given_up(before.results, after.results),
        bootstrap=samples,
        confidence=level,
    )
    return dataclasses.replace(comparison, warnings=tuple(_warnings(comparison, every.n - shared.n)))


def _cases(
    before: FinishedStudy,
    after: FinishedStudy,
    pairs: CasePairs,
    shared: SharedScenarios,
    bootstrap: int,
    confidence: float,
) -> Iterator[CaseComparison]:
    old_at = {design.id: i for i, design in enumerate(before.results.designs)}
    at_new = [i for i, design in enumerate(after.results.designs) if design.id in old_at]
    at_old = [old_at[after.results.designs[i].id] for i in at_new]
    designs = tuple(after.results.designs[i] for i in at_new)
    # all cases together: the intervals hold for every design in every case
    table = paired_differences(
        np.concatenate([case.counted[at_old][:, shared.old] for case, _ in pairs]),
        np.concatenate([case.counted[at_new][:, shared.new] for _, case in pairs]),
        shared.side,
        seed=after.study.seed,
        bootstrap=bootstrap,
        confidence=confidence,
    )
    fresh = _shared_fresh(before, after)
    for i, (case_old, case_new) in enumerate(pairs):
        raced_elsewhere = any(_raced_elsewhere(side.results, case_new.case) for side in (before, after))
        yield CaseComparison(
            case=case_new.case,
            designs=designs,
            S=table.take(range(i * len(designs), (i + 1) * len(designs))),
            failed_old=tuple(case_old.failed[at_old][:, shared.old].sum(axis=1).tolist()),
            failed_new=tuple(case_new.failed[at_new][:, shared.new].sum(axis=1).tolist()),
            winners=None
            if raced_elsewhere
            else compare_winners(
                before, after, case_new.case, shared, fresh, bootstrap=bootstrap, confidence=confidence
            ),
            raced_elsewhere=raced_elsewhere,
        )


def _raced_elsewhere(results: StudyResults, case: Case) -> bool:
    """Whether a race gave up designs that may be the best in this case: it knows the primary case alone."""
    return results.race is not None and bool(results.race.dropped) and results.cases[0].case != case


def _read_both(old: str | Path | FinishedStudy, new: str | Path | FinishedStudy) -> tuple[FinishedStudy, FinishedStudy]:
    folders = [Path(side) for side in (old, new) if not isinstance(side, FinishedStudy)]
    if len(folders) == 2 and folders[0].resolve() == folders[1].resolve():
        raise InputError(f"{old}, {new}: the same folder twice; allowed: the folders of two studies")
    before, after = (side if isinstance(side, FinishedStudy) else FinishedStudy.read(side) for side in (old, new))
    return before, after


def _shared_cases(before: FinishedStudy, after: FinishedStudy) -> CasePairs:
    there = {case.case: case for case in before.results.cases}
    pairs = [(there[case.case], case) for case in after.results.cases if case.case in there]
    if not pairs:
        was, now = ("; ".join(c.case.label for c in side.results.cases) for side in (before, after))
        raise InputError(
            f"{before.source}, {after.source}: no case in both: the old study has {was}, the new one {now}; run one of "
            "them again with a window and a convention of the other in [simulation]"
        )
    return pairs


def _shared_scenarios(before: FinishedStudy, after: FinishedStudy, differences: Sequence[str]) -> SharedScenarios:
    shared = _share(before, after, before.results, after.results)
    if shared.n:
        return shared
    where = f"{before.source}, {after.source}: no scenario in both"
    if shared.other_draws:
        raise InputError(
            f"{where}: {shared.other_draws} departures are the same, but both plants draw numbers for them (noise, "
            "mismatch, residuals); these follow from the seed and the scenario's number, which differ; run one of them "
            "again with the other's seed and number of left scenarios"
        )
    reasons = [text for text in differences if text.startswith(("scenarios", "seed", "ldctoolkit", "numpy"))]
    why = f" ({'; '.join(reasons)})" if reasons else ""
    raise InputError(f"{where}{why}; run one of them again with the other's seed, scenario model and conditions")


def _share(before: FinishedStudy, after: FinishedStudy, old: StudyResults, new: StudyResults) -> SharedScenarios:
    return share_scenarios(
        old.scenarios,
        new.scenarios,
        both_draw=bool(drawn_streams(before.study.plant) & drawn_streams(after.study.plant)),
        same_seed=before.study.seed == after.study.seed,
    )


def _shared_fresh(before: FinishedStudy, after: FinishedStudy) -> SharedScenarios | None:
    """Fresh scenarios of both, if the two studies share any."""
    old, new = before.results.fresh, after.results.fresh
    if old is None or new is None:
        return None
    shared = _driven(_share(before, after, old, new), old, new)
    return shared if shared.n else None


def _driven(shared: SharedScenarios, old: StudyResults, new: StudyResults) -> SharedScenarios:
    """Those that every design of both could be driven on, in every case."""
    rows: npt.NDArray[np.bool_] = np.ones(shared.n, dtype=np.bool_)
    for results, at in ((old, shared.old), (new, shared.new)):
        for case in results.cases:
            rows &= case.drivable[at]
    return shared.take(rows)


def _given_up(*both: StudyResults) -> tuple[Design, ...]:
    """Designs that both studies hold, and a race of one of them gave up."""
    shared = set.intersection(*(set(held_designs(results)) for results in both))
    lost = {one.design.id: one.design for results in both if results.race is not None for one in results.race.dropped}
    return tuple(design for id, design in lost.items() if id in shared)


def _only(results: StudyResults, other: StudyResults) -> tuple[Design, ...]:
    held = held_designs(other)
    return tuple(design for design in results.designs if design.id not in held)


def _failed(
    results: StudyResults, *, ran: StudyResults | None = None, failed: StudyResults | None = None
) -> tuple[FailedDesign, ...]:
    """Designs that failed here and ran, or failed, there."""
    where = {one.design.id for one in failed.failed} if failed else set()
    if ran:
        where = set(held_designs(ran)) - {one.design.id for one in ran.failed}
    return tuple(one for one in results.failed if one.design.id in where)


def _warnings(comparison: Comparison, left_out: int) -> Iterator[str]:
    shared = comparison.shared
    if left_out:
        yield (
            f"{left_out} shared scenario{'' if left_out == 1 else 's'} cannot be driven under some design of one of "
            f"the studies; no comparison counts {'it' if left_out == 1 else 'them'}."
        )
    if shared.other_draws:
        yield (
            f"Departures in both studies with other noise, mismatch or residuals, because the seed or the scenario's "
            f"number differs: {shared.other_draws}; they are not shared."
        )
    if shared.n < _FEW:
        yield f"Only {shared.n} shared scenario{'' if shared.n == 1 else 's'}: the intervals are rough."
    elsewhere = [case.case.label for case in comparison.cases if case.raced_elsewhere]
    if elsewhere:
        yield (
            f"Winners are not compared in {'; '.join(elsewhere)}: a race of one of the studies gave designs up by "
            "their S in its primary case alone, and the best one here may be among them. Run it without a race."
        )
    if any(case.winners is None and not case.raced_elsewhere for case in comparison.cases):
        yield "No design of one of the studies meets its requirements in some case: there is no winner to compare."
    in_control = [case.winners for case in comparison.cases if case.winners and case.case.window == "control"]
    if any(winners.old.y_s != winners.new.y_s for winners in in_control):
        yield (
            "S over the control window starts at the trigger, which moves with y_s: a later trigger gives a smaller S. "
            "Winners with different y_s are not comparable there."
        )
    if comparison.given_up:
        yield (
            f"Designs of both studies that a race in one of them gave up early: {len(comparison.given_up)}; they are "
            "not compared."
        )
