"""The ranking of a study: designs by mean S, with what the scenarios allow to say of them, and `ranking.csv`."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, Frame, IntArray
from ldctoolkit.clusters import doubt_of, several
from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT
from ldctoolkit.errors import StudyError, expect
from ldctoolkit.metrics import METRICS, RELEASE_METRICS, declare, measured_on
from ldctoolkit.vehicle import VehicleModel

from ..design import Design
from ..requirements import SETS, criterion, metric, metric_values, missed_by, requirements_of
from ..results import StudyResults
from ..standards import standard_names
from ..storage.checked_parts import differences
from ..storage.folder_files import write_text
from ..study_file import Study
from ..tables import Table, to_csv, to_polars, to_text
from .design_metrics import (
    design_metrics,
    drivable_results,
    find_baseline,
    measures_of,
    pareto_costs,
    pareto_front,
    sampling_intervals,
)
from .finalists import (
    Criterion,
    FreshScores,
    RankedDesigns,
    RecordingScores,
    ReplayedScores,
    best_of_laws,
    fresh_scores,
    no_fresh_scores,
)
from .inference import Inference, Resampled, infer, row_means, spread_is_known, tail_text
from .verdict import TOP, depths, listed_positions, ranking_html, ranking_table

if TYPE_CHECKING:
    import polars as pl

    from ldctoolkit.setup import Setup


FEW = 50  # scenarios below which intervals are clearly too short, see docs/explanation/statistics.md

FEW_OF_A_SIDE = 10


def warnings_of_sample(
    side: npt.NDArray[np.signedinteger], inference: Inference, cluster: IntArray | None = None
) -> Iterator[str]:
    """Sentences on a sample that is too small, and on references that were left out."""
    sides, counts = np.unique(side, return_counts=True)
    numbers = " and ".join(
        f"{count} {'left' if which == LEFT else 'right'}"
        for which, count in zip(sides[::-1], counts[::-1], strict=True)
    )
    if text := doubt_of(cluster):
        yield f"{text[0].upper()}{text[1:]}."
    independent = several(cluster) is None
    if independent and not spread_is_known(side):
        yield (
            f"There is no interval and no designs are separated: a side has one scenario only ({numbers}), "
            "which shows no spread."
        )
    elif independent and (side.size < FEW or counts.min() < FEW_OF_A_SIDE):
        yield (
            f"Intervals are too short with so few scenarios ({numbers}): below {FEW}, or {FEW_OF_A_SIDE} of a side, "
            "they hold less often than they say. None of them counts the sampling error of the scenario model itself."
        )
    if inference.references < inference.may_be_best:
        yield (
            f"Critical values of the comparisons with the best come from {inference.references} of "
            f"{inference.may_be_best} designs that may be the best: intervals of the differences to the best may be "
            "too short."
        )


_OFTEN = 0.1  # share of a design's interventions with a failed solve that causes a warning
_NAMED = 3  # designs that a warning names


def _warnings_of_runs(every_run: StudyResults, results: StudyResults) -> Iterator[str]:
    """Warnings of scenarios that cannot be driven, of scores that are not comparable, and of failed solves.

    A failed solve of a law without a solver, which has no fallback, is always reported, that of others if frequent.
    """
    total = len(every_run.scenarios)
    if left_out := total - len(results.scenarios):
        yield (
            f"{left_out} of {total} scenarios cannot be driven (a parameter is not finite "
            "or has the wrong sign, or the speed leaves 1 to 90 m/s); no metric of any design counts them."
        )
    if results.window == "control" and len({design.y_s for design in results.designs}) > 1:
        yield (
            "S over the control window starts at the trigger, which moves with y_s: a later trigger gives a smaller S. "
            "Designs with different y_s are not comparable here; use the departure window."
        )
    wrong, often = [], []
    solver = results.measures.get("solver", np.ones(len(results.designs)))
    for i in np.flatnonzero((results.failed_solves > 0).any(axis=1)).tolist():
        design, failed_solves, status = results.designs[i], results.failed_solves[i], results.status[i]
        driven = ~np.isin(status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))
        failing, total = int((failed_solves[driven] > 0).sum()), int(driven.sum())
        if not failing:
            continue
        name = f"{design.label} in {failing:,} of {total:,} interventions"
        if not solver[i]:
            wrong.append(name)
        elif failing >= _OFTEN * total:
            often.append(name)
    if wrong:
        yield f"Commands that were not finite, of laws that declare no solver to fall back from: {_listed(wrong)}."
    for name, values in results.user_metrics.items():
        among = results.status != EventStatus.NEVER_TRIGGERED
        unknown = (np.isnan(values) & (among | (results.user_rows[name].over == "all"))).sum(axis=1)
        if (rows := np.flatnonzero(unknown)).size:
            named = [f"{results.designs[i].label} in {unknown[i]:,} departures" for i in rows.tolist()]
            yield f"Metric {name} is NaN, so that its aggregates are unknown: {_listed(named)}."
    if often:
        yield f"Commands that were not finite, or came from a law's fallback: {_listed(often)}."


def _listed(names: Sequence[str]) -> str:
    more = f"; and {len(names) - _NAMED} more designs" if len(names) > _NAMED else ""
    return "; ".join(names[:_NAMED]) + more


@dataclasses.dataclass(frozen=True, repr=False)
class Ranking(RankedDesigns, Frame):
    """Designs, best first, created with `Ranking.of`; the attributes are those of `RankedDesigns`.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> ranking = ldc.rank_study(results, study)
    >>> ranking.designs[0].law, ranking.metrics.S.shape
    ('lqr', (2,))
    """

    def to_polars(self) -> pl.DataFrame:
        """One row for each design, with the columns of ``ranking.csv``; rank, name and S come first."""
        import polars as pl

        table = to_polars(_table(self)).with_columns(pl.col("rank").cast(pl.Int64))
        first = ["rank", "law", "y_s_m", "S_m_s", "set_of_best", "unmet"]
        return table.select(*first, pl.exclude(first))

    def __str__(self) -> str:
        table = ranking_table(self, listed_positions(self, TOP))
        return "\n".join((table.title, to_text(table), *(f"Warning: {warning}" for warning in self.warnings)))

    def _repr_html_(self) -> str:
        """HTML for a notebook."""
        return ranking_html(self)

    @classmethod
    def of(
        cls,
        results: StudyResults,
        *,
        seed: int = 0,
        bootstrap: int = 2000,
        confidence: float = 0.95,
        D_y: float = 0.5,
        baseline: str = "",
        require: Sequence[str] = (),
        pareto: Sequence[str] = (),
        rank_by: str = "S",
        setup: Setup | None = None,
        vehicles: Sequence[str | VehicleModel] = (),
        standards: Sequence[str] = (),
    ) -> Ranking:
        """Rank the designs of a study.

        Raises `InputError` for settings outside their range, a baseline that does not exist, or scores that are not
        finite; `UnknownNameError` for a metric or set that does not exist.

        The settings are those of ``[ranking]`` in a study file, D_y [m] is the depth that counts as deep. The `setup`
        of the runs gives the limit of friction. The worst of the named `vehicles` and the shares of the named or
        required `standards` are taken from the measures of the run, with an `InputError` for a measure that is missing.
        """
        for own in results.user_rows.values():  # a later study of this process may have others of these names
            declare(own)
        options = None if setup is None else setup.options
        requirements = requirements_of(require, options)
        limits = requirements_of((*require, *(name for name in SETS if name != "lane-edge")), options)
        measured = measured_on(results.options, {limit.metric.name: limit.metric for limit in limits})
        limits = tuple(limit for limit in limits if limit.metric.name in measured)
        pareto_metrics = tuple(metric(name).name for name in pareto)
        reference = find_baseline(baseline, results)
        drivable = drivable_results(results)
        named = (*standards, *pareto_metrics, *(requirement.metric.name for requirement in requirements))
        measures = measures_of(results, vehicles, [name for name in named if name in standard_names()])
        metrics = design_metrics(results, drivable, D_y, measures, setup)
        costs, side = drivable.costs(rank_by), drivable.scenarios.side
        # inference has an absolute tolerance, made for S
        scale = 1.0 if rank_by == "S" else float(np.abs(costs).mean()) or 1.0
        cost = row_means(costs)
        missed = missed_by(requirements, metrics)
        order = np.lexsort((cost, np.array([bool(misses) for misses in missed]))).astype(np.int64)
        ranked = sum(not misses for misses in missed)
        in_order = metrics.take(order)
        position = None if reference is None else int(np.flatnonzero(order == reference)[0])
        cluster = drivable.scenarios.cluster

        def inferred(values: FloatArray) -> tuple[Resampled, Inference]:
            resampled = Resampled.of(values, side, seed=seed, samples=bootstrap, rows=order, cluster=cluster)
            return resampled, infer(resampled, ranked=ranked, baseline=position, confidence=confidence)

        of_S = resampled, inference = inferred(drivable.counted)
        if rank_by != "S":
            resampled, inference = inferred(costs / scale)
        names = [requirement.metric.name for requirement in limits]
        limited = sampling_intervals(drivable, metrics, names, D_y, confidence, setup)[:, :, order]
        mean_S = [name == "S" for name in names]
        limited[mean_S, 1:] = of_S[1].S_low, of_S[1].S_high
        fresh_limited, (fresh_saved, fresh_needless) = np.full_like(limited, np.nan), np.full((2, len(order)), np.nan)
        warnings = list(_warnings_of_runs(results, drivable))
        designs = tuple(results.designs[i] for i in order)
        fresh = fresh_S = no_fresh_scores(len(order), ranked)
        if results.fresh is not None and results.fresh.designs:
            position_of = {design.id: k for k, design in enumerate(designs)}
            positions = np.array([position_of[design.id] for design in results.fresh.designs], dtype=np.int64)
            fresh_results = drivable_results(results.fresh)
            row_of = {design.id: i for i, design in enumerate(results.designs)}
            rows = [row_of[design.id] for design in results.fresh.designs]
            of_finalists = {name: values[rows] for name, values in measures.items()}
            fresh_metrics = design_metrics(results.fresh, fresh_results, D_y, of_finalists, setup)
            unmet = [
                tuple(miss.requirement.text for miss in misses) for misses in missed_by(requirements, fresh_metrics)
            ]
            first_failed = designs[0] in [failure.design for failure in results.fresh.failed]

            def scored(values: FloatArray, study_scores: Resampled) -> FreshScores:
                return fresh_scores(
                    fresh_results,
                    values,
                    positions,
                    study_scores,
                    inference,
                    unmet,
                    first_failed=first_failed,
                    ranked=ranked,
                    baseline=position,
                    paired=position is not None and not designs[position].is_baseline,
                    seed=seed,
                    samples=bootstrap,
                    confidence=confidence,
                )

            fresh_S = scored(fresh_results.counted, of_S[0])
            fresh = fresh_S if rank_by == "S" else scored(fresh_results.costs(rank_by) / scale, resampled)
            warnings += _about_finalists(fresh, ranked)
            intervals = sampling_intervals(fresh_results, fresh_metrics, names, D_y, confidence, setup)
            worst = [name == "comfortable_worst" for name in names]  # driven on the study's departures only
            intervals[worst] = limited[worst][:, :, positions]
            fresh_limited[:, :, positions] = intervals
            fresh_limited[mean_S, 1:] = fresh_S.low, fresh_S.high
            fresh_saved[positions] = fresh_metrics.reduction
            fresh_needless[positions] = metric_values("needless", fresh_metrics)
        acting = [i for i, design in enumerate(designs) if not design.is_baseline]
        if requirements and acting and not any(i < ranked for i in acting):
            fresh = dataclasses.replace(fresh, winner=None)  # no control is not a design to choose
        warnings += warnings_of_sample(side, inference, cluster)
        replayed, refits = results.replayed, results.refits
        for what, text in (
            ("replayed departures", "" if replayed is None else doubt_of(replayed.scenarios.cluster)),
            ("recordings behind the model", "" if refits is None else refits.doubt),
        ):
            warnings += [f"Of the {what}: {text}."] if text else []
        for i in best_of_laws(designs):
            if not designs[i].is_baseline and (text := tail_text(*depths(results, int(order[i]), setup))):
                warnings.append(f"{designs[i].label} is {text}.")
        at_fresh = fresh_S.S, fresh_S.baseline_difference, fresh_saved
        elsewhere = in_order.S, of_S[1].baseline_difference, in_order.reduction
        known = [np.isfinite(values) for values in at_fresh]
        centres = np.stack([np.where(*columns) for columns in zip(known, at_fresh, elsewhere, strict=True)])
        ids = [design.id for design in designs]
        front = np.zeros(len(order), dtype=np.bool_)
        if pareto_metrics and ranked:
            front[:ranked] = pareto_front(pareto_costs(pareto_metrics, metrics)[order[:ranked]])
        best_first = cost[order[:ranked]]
        rank = np.zeros(len(order), dtype=np.int64)
        rank[:ranked] = np.searchsorted(best_first, best_first, side="left") + 1
        ranked_by = None
        if rank_by != "S":
            ranked_by = _criterion(rank_by, scale, cost[order], inference, fresh)
            inference = _in_unit(inference, scale, S_low=of_S[1].S_low, S_high=of_S[1].S_high)
            of_fresh = {name: getattr(fresh_S, name) for name in ("S", "low", "high", "reduction")}
            fresh = _in_unit(fresh, scale, **of_fresh)
        return cls(
            metrics=in_order,
            inference=inference,
            fresh=fresh,
            replayed=_replayed(
                results.replayed,
                designs,
                seed=seed,
                bootstrap=bootstrap,
                confidence=confidence,
                D_y=D_y,
                baseline=baseline,
            ),
            recordings=RecordingScores.of(results.refits, ids, centres, fresh.winner, position, confidence),
            window=results.window,
            convention=results.convention,
            designs=designs,
            index=order,
            rank=rank,
            missed=tuple(missed[i] for i in order),
            requirements=requirements,
            limits=limits,
            limited=limited,
            fresh_limited=fresh_limited,
            fresh_saved=fresh_saved,
            fresh_needless=fresh_needless,
            baseline=position,
            pareto=front,
            pareto_metrics=pareto_metrics,
            scenarios=side.size,
            D_y=D_y,
            bootstrap=bootstrap,
            confidence=confidence,
            warnings=tuple(warnings),
            failed=results.failed,
            criterion=ranked_by,
        )


_Differences = TypeVar("_Differences", Inference, FreshScores)


def _in_unit(of: _Differences, scale: float, **of_S: Any) -> _Differences:
    """Differences and optimism in the unit of the criterion of the ranking; `of_S` are values that stay those of S."""
    names = [f.name for f in dataclasses.fields(of) if "difference" in f.name or f.name.startswith("optimism")]
    scaled: dict[str, Any] = {name: scale * getattr(of, name) for name in names if name != "optimism_paired"}
    return dataclasses.replace(of, **scaled, **of_S)


def _criterion(rank_by: str, scale: float, cost: FloatArray, inference: Inference, fresh: FreshScores) -> Criterion:
    """What is ranked by, in its own unit and direction."""
    row = criterion(rank_by)
    study, again = (cost, scale * inference.S_low, scale * inference.S_high), (fresh.S, fresh.low, fresh.high)
    columns = [*study, *(scale * values for values in again)]
    if row.better == "more":
        columns = [-columns[i] for i in (0, 2, 1, 3, 5, 4)]
    return Criterion(row, *columns)


def _replayed(results: StudyResults | None, designs: Sequence[Design], **settings: Any) -> ReplayedScores:
    """Scores of the finalists on recorded departures."""
    columns = np.full((4, len(designs)), np.nan)
    if results is not None and results.designs:
        ranking = Ranking.of(results, **settings)
        position_of = {design.id: i for i, design in enumerate(designs)}
        numbers = (ranking.metrics.S, ranking.inference.S_low, ranking.inference.S_high, ranking.metrics.reduction)
        columns[:, [position_of[design.id] for design in ranking.designs]] = numbers
    S, low, high, reduction = columns
    return ReplayedScores(S, low, high, reduction, 0 if results is None else int(results.drivable.sum()))


def rank_study(results: StudyResults, study: Study) -> Ranking:
    """Rank the designs of a study with the study's own settings.

    Raises `StudyError` if the results hold none of the study's designs, or are of another vehicle, plant or simulation;
    `InputError` for an argument of a wrong type.

    Parameters
    ----------
    results : StudyResults
        What `run_study` or `read_results` returned.
    study : Study
        The study that was run, or one of its designs with other settings for the ranking.

    Returns
    -------
    Ranking

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> [design.law for design in ldc.rank_study(results, study).designs]
    ['lqr', 'none']
    """
    expect("results", results, StudyResults)
    expect("study", study, Study)
    if study.search is None and not {design.id for design in study.designs} & {design.id for design in results.designs}:
        raise StudyError(
            "study", "has none of the designs of the results", value=study.name, allowed="the one that was run"
        )
    _check_setup(results, study)
    settings = study.ranking
    ranking = Ranking.of(
        results,
        seed=study.seed,
        bootstrap=settings.bootstrap,
        confidence=settings.confidence,
        D_y=study.report.D_y,
        baseline=settings.baseline,
        require=settings.require,
        pareto=settings.pareto,
        rank_by=settings.rank_by,
        setup=results.setup or study.setup(),
        vehicles=study.vehicles,
        standards=study.standards,
    )
    sampled = [space for block in study.design if study.search or block.sample for space in block.space()]
    ranges = tuple((space.law, name, values) for space in sampled for name, values in space.dimensions)
    return dataclasses.replace(ranking, ranges=ranges)


def _check_setup(results: StudyResults, study: Study) -> None:
    """Raise `StudyError` if the runs, and what was measured beside them, are of another vehicle, plant or simulation.

    Another seed is allowed: it decides the bootstrap. Where departures are replayed, a run takes the widths of vehicle
    and lane from their recordings.
    """
    if results.setup is None:
        return
    run, now = (dataclasses.asdict(setup) for setup in (results.setup, study.setup()))
    of_the_run = {"seed", *(() if study.scenarios.model else ("vehicle.w_v", "vehicle.w_l"))}
    for key, was, value in differences(run, now):
        if key not in of_the_run:
            path = re.sub("^options", "plant", key) if "." in key else f"simulation.{key}"
            raise StudyError(f"study {study.name}: {path}", value=value, allowed=f"{was!r}, as in the run")


def _about_finalists(fresh: FreshScores, ranked: int) -> Iterator[str]:
    """Warnings of finalists that rank before the winner but miss a requirement on the fresh scenarios."""
    if not ranked:
        return
    if fresh.winner is None:
        texts = " or ".join(dict.fromkeys(text for texts in fresh.unmet for text in texts))
        yield (
            f"No finalist meets the requirements on the fresh scenarios (each misses {texts}): there is no winner. "
            "Ask for more finalists, or leave a margin in the requirements."
        )
        return
    for i, missed in enumerate(fresh.unmet[: fresh.winner]):
        if missed:
            yield f"Design # {i + 1} misses {', '.join(missed)} on the fresh scenarios and is not the winner."


_PAIRED: Final = (
    "difference difference_low difference_high baseline_difference baseline_difference_low baseline_difference_high"
)
_SCORES: Final = (
    ("metrics", "", "S"),
    ("inference", "", "S_low S_high"),
    ("metrics", "", "S_p95 S_cvar95 S_left S_right S_uncorrected reduction reduction_left reduction_right"),
    ("inference", "", f"{_PAIRED} set_of_best best_frequency"),
    ("fresh", "fresh_", f"S low high {_PAIRED} reduction optimism optimism_low optimism_high"),
    ("replayed", "replayed_", "S low high reduction"),
    (
        "recordings",
        "recordings_",
        "low high baseline_difference_low baseline_difference_high reduction_low reduction_high",
    ),
)
"""Tables of a ranking, the prefix of their columns, and the attributes that have one: scores with their intervals."""

_COUNTS: Final = ("solver_failed", "diverged", "timed_out", "crashed", "beyond_delta_max", "invalid", "failed_solves")


def _numbers(ranking: Ranking) -> dict[str, Any]:
    """Column of ``ranking.csv`` -> (d,) scores with their intervals, then the other metrics."""
    numbers = {
        _column_of(prefix, name, ranking): getattr(getattr(ranking, table), name)
        for table, prefix, names in _SCORES
        for name in names.split()
    }
    if (of := ranking.criterion) is not None:
        ends = {"_low": of.low, "_high": of.high}
        for prefix, values in (("", ends), ("fresh_", {"": of.fresh, "_low": of.fresh_low, "_high": of.fresh_high})):
            numbers |= {of.metric.column_of(f"{prefix}{of.metric.name}{end}"): column
                        for end, column in values.items()}  # fmt: skip
    numbers["pareto"] = ranking.pareto
    numbers["winner"] = np.arange(len(ranking)) == ranking.winner
    numbers |= {METRICS[name].column: getattr(ranking.metrics, name) for name in ("triggered", "deeper")}
    numbers |= {name: getattr(ranking.metrics, name) for name in _COUNTS}
    beside = ranking.metrics.beside
    standards = [name for name in beside if name not in METRICS]
    named = (*(name for name in RELEASE_METRICS if name in beside), *standards)
    return numbers | {metric(name).column: beside[name] for name in named}


def _column_of(prefix: str, name: str, ranking: Ranking) -> str:
    """Column of a score, or of an interval's end; a pure number has the attribute's name."""
    if name in ("set_of_best", "best_frequency") or "reduction" in name:
        return prefix + name
    if name.startswith("difference"):
        to = "first" if prefix else "best"
        name = name.replace("difference", f"difference_to_{to}", 1) if prefix or name == "difference" else name
    column = name if name.startswith("optimism") else f"{prefix}{name}"
    # what the recordings leave open is known for S alone
    of_S = prefix == "recordings_" or not re.search("difference|optimism", name)
    return (METRICS["S"] if of_S else ranking.ranked_by).column_of(column)


def write_csv(ranking: Ranking, path: str | Path) -> None:
    """Write a ranking as a CSV file, whole or not at all."""
    write_text(Path(path), to_csv(_table(ranking)))


def _table(ranking: Ranking) -> Table:
    """The numbers of every design, in SI units."""
    laws = {design.law: design for design in _all_designs(ranking)}
    gains = list(dict.fromkeys(column for _, design in sorted(laws.items()) for column in _gain_columns(design)))
    rows = list(_rows(ranking, gains))
    return Table.of(rows[0], rows, text=("design", "label", "unmet", "fresh_unmet", "failure"))


def _all_designs(ranking: Ranking) -> Iterator[Design]:
    yield from ranking.designs
    yield from (failure.design for failure in ranking.failed)


def _gain_columns(design: Design) -> list[str]:
    """Column of every gain of a law; a gain of one name and unit shares its column between laws."""
    units = {"1": "", "samples": ""}
    return [
        g.name + (f"_{unit}" if (unit := units.get(g.unit, g.unit.replace("/", "_per_").replace("^", ""))) else "")
        for g in design.kind.gains()
    ]


def _rows(ranking: Ranking, gains: Sequence[str]) -> Iterator[dict[str, Any]]:
    numbers = _numbers(ranking)
    for fresh, values in (("", ranking.limited), ("fresh_", ranking.fresh_limited)):
        for limit, ends in zip(ranking.limits, values[:, 1:], strict=True):
            if not np.isnan(ends).all():
                name = limit.metric.name
                column = f"{fresh}{name}_{{}}{limit.metric.column.removeprefix(name)}"
                numbers |= dict(zip(map(column.format, ("low", "high")), ends, strict=True))
    reasons = [""] * len(ranking) + [failure.reason for failure in ranking.failed]
    optimism_of = "baseline_difference" if ranking.fresh.optimism_paired else ranking.ranked_by.name
    for i, (design, reason) in enumerate(zip(_all_designs(ranking), reasons, strict=True)):
        here = i < len(ranking)
        gain_values = dict(zip(_gain_columns(design), (value for _, value in design.gains), strict=True))
        yield {
            "window": ranking.window,
            "convention": ranking.convention,
            "rank": int(ranking.rank[i]) or None if here else None,
            "design": design.id,
            "label": design.label,
            "law": design.law,
            "y_s_m": design.y_s,
            **{f"gain_{name}": gain_values.get(name) for name in gains},
            **{name: column[i] if here else None for name, column in numbers.items()},
            "unmet": "; ".join(ranking.unmet[i]) if here else "",
            "fresh_unmet": "; ".join(ranking.fresh.unmet[i]) if here else "",
            "optimism_of": optimism_of if here and not np.isnan(ranking.fresh.optimism[i]) else None,
            "failure": reason,
        }
