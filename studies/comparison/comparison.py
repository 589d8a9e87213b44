"""The comparison of two studies, its tables and its files."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.clusters import doubt_of
from ldctoolkit.errors import InputError
from ldctoolkit.metrics import declare
from ldctoolkit.simulation import Window

from ..design import Design
from ..requirements import criterion
from ..results import FailedDesign, StudyResults
from ..storage.folder_files import write_text
from ..tables import Cell, Column, Row, Table, notebook_html, to_csv
from ..text import DASH, difference_text, figure, number, plural
from .paired import (
    THRESHOLD,
    FinishedStudy,
    PairedDifferences,
    SharedScenarios,
    Verdict,
    Winners,
    compare_winners,
    drawn_streams,
    held_designs,
    input_differences,
    paired_differences,
    share_scenarios,
)

PHRASES: Final = {
    Verdict.BETTER: "better",
    Verdict.WORSE: "worse",
    Verdict.NOT_SEPARATED: "not separated",
    Verdict.SAME: "the same",
}
"""The phrase of each verdict in a sentence."""

TOP: Final = 20  # rows of a notebook


@dataclasses.dataclass(frozen=True)
class Comparison:
    """An old and a new study on shared scenarios.

    Fields of the k designs of both studies have an entry for each design, in the order of the new study.

    Examples
    --------
    >>> import tempfile
    >>> import ldctoolkit as ldc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name, law in (("old", ldc.LQR(r_delta=1000.0)), ("new", ldc.LQR)):
    ...         study = ldc.study(ldc.NoControl, law, name=name, left=20, right=20)
    ...         _ = ldc.run_study(study, directory=f"{folder}/{name}", workers=1)
    ...     comparison = ldc.compare(f"{folder}/old", f"{folder}/new")
    >>> len(comparison.only_old), len(comparison.only_new)
    (1, 1)
    """

    old: str  # Folder
    new: str
    old_name: str  # Name of the study
    new_name: str
    differences: tuple[str, ...]  # Of inputs that decide the numbers, as ``"vehicle.m: 1000.0 -> 1100.0"``
    shared: SharedScenarios  # Those that can be driven in both studies
    window: Window  # Of S
    label: str  # Window of S, and reading of the paper
    designs: tuple[Design, ...]  # The k designs
    S: PairedDifferences  # Mean S in both studies, their difference with its interval, and the verdict
    # Shared scenarios that failed (solver failed, diverged, timed out, crashed)
    failed_old: tuple[int, ...]
    failed_new: tuple[int, ...]
    # The winner of the new study against that of the old study; None where a study has no winner
    winners: Winners | None
    only_old: tuple[Design, ...]  # Designs with results in this study that the other does not contain
    only_new: tuple[Design, ...]
    # Designs of both studies whose law failed in the new one only, in the old one only, and in both
    new_failures: tuple[FailedDesign, ...]
    repaired: tuple[FailedDesign, ...]
    failed_in_both: tuple[FailedDesign, ...]
    bootstrap: int  # Resamples
    confidence: float  # Of the intervals, simultaneous over all designs
    warnings: tuple[str, ...] = ()
    # The same as `S` of each designer's metric that both studies have: means over all departures, in its unit
    metrics: Mapping[str, PairedDifferences] = dataclasses.field(default_factory=dict)

    def _repr_html_(self) -> str:
        """The comparison in a notebook."""
        lines = (f"{self.old_name} \u2192 {self.new_name}", self.summary, *self.differences)
        table = design_table(self, self.order[:TOP])
        return notebook_html(lines, self.warnings, table, len(self) - len(table.rows))

    def __len__(self) -> int:
        return len(self.designs)

    def count(self, verdict: Verdict) -> int:
        """Number of designs with this verdict."""
        return self.S.verdict.count(verdict)

    @property
    def counts(self) -> str:
        """Numbers of designs that are better, worse, not separated, the same."""
        return ", ".join(f"{self.count(verdict):,} {PHRASES[verdict]}" for verdict in Verdict)

    @property
    def order(self) -> tuple[int, ...]:
        """Positions of the designs: worse ones first, then better, not separated, unchanged; large changes first."""
        rank = [Verdict.WORSE, Verdict.BETTER, Verdict.NOT_SEPARATED, Verdict.SAME].index
        return tuple(
            sorted(range(len(self)), key=lambda i: (rank(self.S.verdict[i]), -abs(float(self.S.difference[i]))))
        )

    @property
    def any_worse(self) -> bool:
        """Whether a design is worse or fails only in the new study, or the new winner is worse than the old one."""
        winner_is_worse = self.winners is not None and self.winners.verdict is Verdict.WORSE
        return bool(self.new_failures) or winner_is_worse or self.count(Verdict.WORSE) > 0

    @property
    def summary(self) -> str:
        """The numbers of scenarios and verdicts in a sentence."""
        shared = f"{self.shared.n:,} shared scenarios ({self.shared.left:,} left, {self.shared.right:,} right)"
        if len(self):
            summary = f"{plural(len(self), 'design')} in both, {self.label}: {self.counts}"
        else:
            summary = f"no design in both, {self.label}"
        failed = f"; {len(self.new_failures)} failed only in the new study" if self.new_failures else ""
        winners = "no winner" if self.winners is None else PHRASES[self.winners.verdict]
        return f"{shared}; {summary}{failed}; the new winner against the old one: {winners}."


def design_table(comparison: Comparison, positions: Sequence[int]) -> Table:
    """Table of the designs at these positions."""
    S, unit = comparison.S, "m\u00b7s"
    columns = [
        Column("Verdict", text=True), Column("Design", text=True), Column("Old S", unit, ".4f", key="old"),
        Column("New S", unit, ".4f", key="new"), Column("New \u2212 old", unit, difference_text, key="difference"),
        Column(f"{100 * comparison.confidence:g} % interval", unit, difference_text),
        Column("Scenarios changed", key="changed"), Column("Largest change", unit), Column("Failed, old / new"),
    ]  # fmt: skip
    columns += [Column(f"New \u2212 old {criterion(name).title}", criterion(name).shown_unit, difference_text)
                for name in comparison.metrics]  # fmt: skip
    numbers = np.stack([S.S_old, S.S_new, S.difference, S.low, S.high, S.largest], axis=1)
    rows = []
    for i in positions:
        *scores, low, high, largest = numbers[i].tolist()
        changed, failed = int(S.changed[i]), (comparison.failed_old[i], comparison.failed_new[i])
        at = f"{difference_text(largest)} (no. {comparison.shared.new[S.largest_at[i]]})"
        rows.append(
            Row(
                [
                    verdict_cell(S.verdict[i]),
                    comparison.designs[i].label,
                    *scores,
                    interval_cell(low, high),
                    changed,
                    at if changed else DASH,
                    f"{failed[0]:,} / {failed[1]:,}" if any(failed) else DASH,
                    *(criterion(name).scale * float(of.difference[i]) for name, of in comparison.metrics.items()),
                ],
                "same" if S.verdict[i] is Verdict.SAME else "",
            )
        )
    shared = f"{plural(len(comparison), 'design')} in both studies, {comparison.shared.n:,} shared scenarios"
    return Table(f"{shared}, {comparison.label}: {comparison.counts}", columns, rows, head=1)


def verdict_cell(verdict: Verdict, more: str = "") -> Cell:
    """The cell of a verdict."""
    return Cell(f"{PHRASES[verdict]}{more}", bad=verdict is Verdict.WORSE, good=verdict is Verdict.BETTER)


def interval_cell(low: float, high: float) -> Cell:
    """The cell of an interval: both ends, or why there is none."""
    few = "too few departures changed" if math.isnan(low + high) else "too few departures"
    return Cell((low, high), "" if math.isfinite(low + high) else few)


def winners_sentence(winners: Winners | None) -> str:
    """Whether the new winner is better, and whether that matters."""
    if winners is None:
        return "No design of one of the studies meets its requirements: there is no winner to compare."
    which = "fresh" if winners.fresh else "study"
    small = f", less than the {THRESHOLD:g} m\u00b7s that matter in practice" if winners.is_small else ""
    size = abs(winners.difference)
    by = f"by {number(size, 4) if size >= 1e-3 else figure(size, 2)} m\u00b7s{small}"
    if winners.same_design:
        start = f"{winners.new.label} is the winner of both studies; on shared {which} scenarios its mean S "
        end = {Verdict.BETTER: f"falls {by}", Verdict.WORSE: f"rises {by}", Verdict.SAME: "is the same",
               Verdict.NOT_SEPARATED: "changes within sampling error"}  # fmt: skip
        return f"{start}{end[winners.verdict]}."
    start = f"On shared {which} scenarios the new winner, {winners.new.label}, is "
    old = f"the old one, {winners.old.label}"
    end = {Verdict.BETTER: f"better than {old}, {by}", Verdict.WORSE: f"worse than {old}, {by}",
           Verdict.SAME: f"as good as {old}", Verdict.NOT_SEPARATED: f"not separated from {old}"}  # fmt: skip
    return f"{start}{end[winners.verdict]}."


_FEW = 200  # with fewer shared scenarios intervals are rough


def compare(
    old: str | Path | FinishedStudy,
    new: str | Path | FinishedStudy,
    *,
    bootstrap: int | None = None,
    confidence: float | None = None,
) -> Comparison:
    """Compare two finished studies on the scenarios that they share.

    Raises `StoreError` if a folder holds no study, or one that is broken or not finished; `InputError` if the studies
    cannot be compared: the same folder twice, two windows of S, no scenario in both.

    Parameters
    ----------
    old, new : path or FinishedStudy
        Folders of the studies.
    bootstrap : int, optional
        Resamples of the scenarios; the new study's by default.
    confidence : float, optional
        Of the intervals, simultaneous over all designs; the new study's by default.

    Returns
    -------
    Comparison
        Differences are new minus old, so that a negative one is an improvement.

    Notes
    -----
    Designs are matched by identifier: same law, gains and y_s. Each mean counts a failed scenario at least as bad as
    without control. Random numbers that only one study draws for a scenario are part of the comparison; those that both
    studies draw have to be equal.

    Examples
    --------
    >>> import tempfile
    >>> from ldctoolkit import Study, compare, run_study
    >>> def study(m):
    ...     content = {"name": "small", "scenarios": {"left": 40, "right": 40}, "vehicle": {"m": m}}
    ...     return Study.from_dict(content | {"design": [{"law": "none"}, {"law": "lqr"}]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for m in (1000.0, 1300.0):
    ...         _ = run_study(study(m), directory=f"{folder}/{m:g}", workers=1)
    ...     comparison = compare(f"{folder}/1000", f"{folder}/1300")
    >>> comparison.differences
    ('vehicle.m: 1000.0 -> 1300.0',)
    >>> [str(verdict) for verdict in comparison.S.verdict]
    ['same', 'worse']
    """
    folders = [Path(side) for side in (old, new) if not isinstance(side, FinishedStudy)]
    if len(folders) == 2 and folders[0].resolve() == folders[1].resolve():
        raise InputError(f"{old}, {new}", "the same folder twice", allowed="the folders of two studies")
    before, after = (side if isinstance(side, FinishedStudy) else FinishedStudy.read(side) for side in (old, new))
    settings = after.study.ranking
    samples = settings.bootstrap if bootstrap is None else bootstrap
    level = settings.confidence if confidence is None else confidence
    differences = tuple(input_differences(before, after))
    if before.results.window != after.results.window:
        raise InputError(
            f"{before.source}, {after.source}",
            f"S of the {before.results.window} window in the old study, of the {after.results.window} window in the "
            "new one",
            hint="run one of them again with the other's window in [simulation]",
        )
    every = _shared_scenarios(before, after, differences)
    shared = _driven(every, before.results, after.results)
    if not shared.n:
        raise InputError(f"{before.source}, {after.source}", "no shared scenario could be driven under every design")
    in_old, in_new = held_designs(before.results), held_designs(after.results)
    old_at = {design.key: i for i, design in enumerate(before.results.designs)}
    at_new = [i for i, design in enumerate(after.results.designs) if design.key in old_at]
    at_old = [old_at[after.results.designs[i].key] for i in at_new]
    convention, label = after.results.convention, after.results.label
    if before.results.convention != convention:
        label = f"{before.results.label} -> {convention.replace('_', ' ')}"
    chance: dict[str, Any] = {"bootstrap": samples, "confidence": level}
    comparison = Comparison(
        old=before.source,
        new=after.source,
        old_name=before.study.name,
        new_name=after.study.name,
        differences=differences,
        shared=shared,
        window=after.results.window,
        label=label,
        designs=tuple(after.results.designs[i] for i in at_new),
        S=paired_differences(
            before.results.counted[at_old][:, shared.old],
            after.results.counted[at_new][:, shared.new],
            shared.side,
            cluster=shared.cluster,
            seed=after.study.seed,
            **chance,
        ),
        metrics=dict(_metric_differences(before, after, (at_old, at_new), shared, **chance)),
        failed_old=tuple(before.results.failed_runs[at_old][:, shared.old].sum(axis=1).tolist()),
        failed_new=tuple(after.results.failed_runs[at_new][:, shared.new].sum(axis=1).tolist()),
        winners=compare_winners(before, after, shared, _shared_fresh(before, after), **chance),
        only_old=tuple(design for design in before.results.designs if design.key not in in_new),
        only_new=tuple(design for design in after.results.designs if design.key not in in_old),
        new_failures=_failed(after.results, ran=before.results),
        repaired=_failed(before.results, ran=after.results),
        failed_in_both=_failed(after.results, failed=before.results),
        **chance,
    )
    return dataclasses.replace(comparison, warnings=tuple(_comparison_warnings(comparison, every.n - shared.n)))


def _metric_differences(
    before: FinishedStudy, after: FinishedStudy, at: tuple[list[int], list[int]], shared: SharedScenarios, **chance: Any
) -> Iterator[tuple[str, PairedDifferences]]:
    """Differences of means over all departures, of metrics that both studies have with the same content."""
    known = {metric.name: metric.code for metric in before.study.metrics}
    for metric in after.study.metrics:
        if known.get(declare(metric).name) == metric.code:
            sides = zip((before, after), at, (shared.old, shared.new), strict=True)
            old, new = (side.results.user_metrics[metric.name][rows][:, columns]
                        for side, rows, columns in sides)  # fmt: skip
            if np.isfinite(old).all() and np.isfinite(new).all():
                seed = after.study.seed
                yield (
                    metric.name,
                    paired_differences(old, new, shared.side, cluster=shared.cluster, seed=seed, **chance),
                )


def _shared_scenarios(before: FinishedStudy, after: FinishedStudy, differences: Sequence[str]) -> SharedScenarios:
    shared = _share(before, after, before.results, after.results)
    if shared.n:
        return shared
    where = f"{before.source}, {after.source}"
    if shared.other_draws:
        raise InputError(
            where,
            f"no scenario in both: {shared.other_draws} departures are the same, but both plants draw numbers for them "
            "(noise, mismatch, residuals)",
            hint="these follow from the seed and the scenario's number, which differ; run one of them again with the "
            "other's seed and number of left scenarios",
        )
    reasons = [text for text in differences if text.startswith(("scenarios", "seed", "ldctoolkit", "numpy"))]
    why = f" ({'; '.join(reasons)})" if reasons else ""
    hint = "run one of them again with the other's seed, scenario model and conditions"
    raise InputError(where, f"no scenario in both{why}", hint=hint)


def _share(before: FinishedStudy, after: FinishedStudy, old: StudyResults, new: StudyResults) -> SharedScenarios:
    return share_scenarios(
        old.scenarios,
        new.scenarios,
        both_draw=bool(drawn_streams(before.study.plant) & drawn_streams(after.study.plant)),
        same_seed=before.study.seed == after.study.seed,
    )


def _shared_fresh(before: FinishedStudy, after: FinishedStudy) -> SharedScenarios | None:
    """Shared fresh scenarios; None if there are none."""
    old, new = before.results.fresh, after.results.fresh
    if old is None or new is None:
        return None
    shared = _driven(_share(before, after, old, new), old, new)
    return shared if shared.n else None


def _driven(shared: SharedScenarios, old: StudyResults, new: StudyResults) -> SharedScenarios:
    """The shared scenarios that can be driven under every design of both studies."""
    return shared.take(old.drivable[shared.old] & new.drivable[shared.new])


def _failed(
    results: StudyResults, *, ran: StudyResults | None = None, failed: StudyResults | None = None
) -> tuple[FailedDesign, ...]:
    """Failed designs that ran in the study `ran`, or failed in the study `failed` too."""
    keys = {failure.design.key for failure in failed.failed} if failed else set()
    if ran:
        keys = set(held_designs(ran)) - {failure.design.key for failure in ran.failed}
    return tuple(failure for failure in results.failed if failure.design.key in keys)


def _comparison_warnings(comparison: Comparison, left_out: int) -> Iterator[str]:
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
    if text := doubt_of(shared.cluster):
        yield f"{text[0].upper()}{text[1:]}."
    if shared.n < _FEW:
        yield f"Only {shared.n} shared scenario{'' if shared.n == 1 else 's'}: the intervals are rough."
    winners = comparison.winners
    if winners is None:
        yield winners_sentence(None)
    elif comparison.window == "control" and winners.old.y_s != winners.new.y_s:
        yield (
            "S over the control window starts at the trigger, which moves with y_s: a later trigger gives a smaller S. "
            "Winners with different y_s are not comparable there."
        )


_NAMES = "compared verdict design_old design_new label_old label_new"
_SCORES = "S_old_m_s S_new_m_s difference_m_s difference_low_m_s difference_high_m_s scenarios"
_CHANGED = "changed_scenarios largest_change_m_s largest_change_scenario failed_scenarios_old failed_scenarios_new"
_METRIC: Final = ("old", "new", "difference", "difference_low", "difference_high")
COLUMNS = (*_NAMES.split(), *_SCORES.split(), *_CHANGED.split(), "failure")
"""Columns of the CSV file; fields without a value are empty."""


def comparison_rows(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Rows of the CSV file: each design, the winners if there are any, and each failed design."""
    for i in comparison.order:
        yield {"compared": "design"} | _design_row(comparison, i)
    if (winners := comparison.winners) is not None:
        scores = (winners.S_old, winners.S_new, winners.difference)
        ends = (winners.low, winners.high)
        row = _row_of(str(winners.verdict), winners.old, winners.new, scores, ends, winners.scenarios)
        yield {"compared": "winners"} | row
    failures = {
        "new failure": comparison.new_failures,
        "no longer fails": comparison.repaired,
        "fails in both": comparison.failed_in_both,
    }
    for verdict, failed in failures.items():
        for failure in failed:
            names = {"design_old": failure.design.id, "design_new": failure.design.id}
            labels = {"label_old": failure.design.label, "label_new": failure.design.label}
            yield {"compared": "failure", "verdict": verdict, **names, **labels, "failure": failure.reason}


def _row_of(
    verdict: str, old: Design, new: Design, scores: Sequence[float], ends: Sequence[float], scenarios: int
) -> dict[str, Any]:
    """The columns that designs and winners share; `scores` are S old, S new and their difference."""
    names = _NAMES.split()[1:] + _SCORES.split()
    numbers = [*map(float, scores), *(float(end) if math.isfinite(end) else None for end in ends)]
    return dict(zip(names, (verdict, old.id, new.id, old.label, new.label, *numbers, scenarios), strict=True))


def _design_row(comparison: Comparison, i: int) -> dict[str, Any]:
    design, S = comparison.designs[i], comparison.S
    scores, changed = (S.S_old[i], S.S_new[i], S.difference[i]), int(S.changed[i])
    users = {
        criterion(name).column_of(f"{name}_{what}"): float(values[i]) if math.isfinite(values[i]) else None
        for name, of in comparison.metrics.items()
        for what, values in zip(_METRIC, (of.S_old, of.S_new, of.difference, of.low, of.high), strict=True)
    }
    row = _row_of(str(S.verdict[i]), design, design, scores, (S.low[i], S.high[i]), comparison.shared.n)
    return (
        row
        | users
        | {
            "changed_scenarios": changed,
            "largest_change_m_s": float(S.largest[i]),
            "largest_change_scenario": int(comparison.shared.new[S.largest_at[i]]) if changed else None,
            "failed_scenarios_old": comparison.failed_old[i],
            "failed_scenarios_new": comparison.failed_new[i],
        }
    )


def write_comparison(comparison: Comparison, path: str | Path) -> None:
    """Write a comparison as one CSV file, whole or not at all."""
    rows = [*comparison_rows(comparison)]
    users = [criterion(name).column_of(f"{name}_{what}") for name in comparison.metrics for what in _METRIC]
    write_text(Path(path), to_csv(Table.of((*COLUMNS[:-1], *users, COLUMNS[-1]), rows)))


def comparison_content(comparison: Comparison) -> dict[str, Any]:
    """A comparison in plain JSON types."""
    shared = comparison.shared
    return {
        "old": {"folder": comparison.old, "study": comparison.old_name},
        "new": {"folder": comparison.new, "study": comparison.new_name},
        "S": comparison.label,
        "summary": comparison.summary,
        "worse": comparison.any_worse,
        "differences": list(comparison.differences),
        "shared_scenarios": {
            "left": shared.left,
            "right": shared.right,
            "same_departure_other_draws": shared.other_draws,
        },
        "bootstrap": comparison.bootstrap,
        "confidence": comparison.confidence,
        "warnings": list(comparison.warnings),
        "only_old": [design.id for design in comparison.only_old],
        "only_new": [design.id for design in comparison.only_new],
        "rows": list(comparison_rows(comparison)),
    }
