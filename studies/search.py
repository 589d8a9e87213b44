"""Search for designs with Optuna: batches are proposed and scored; the same values lead to the same designs."""

from __future__ import annotations

import contextlib
import itertools
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from ldctoolkit.declared import GainValue
from ldctoolkit.errors import InputError

from .design import Design
from .design_space import Dimension, LawSpace, Span, rounded
from .measures import measured
from .ranking.design_metrics import pareto_front
from .ranking.ranking import Ranking
from .requirements import metric, metric_values, requirements_of
from .running.campaign import Campaign
from .storage.manifest import write_designs
from .study_file import SearchSettings, Study

_STREAM: Final = 0x73656172  # of the random numbers of a search
_MOST_REPEATS: Final = 100  # so many known designs in a row: the sampler has nothing new to propose


class LawSearch:
    """The search within one law."""

    def __init__(
        self,
        space: LawSpace,
        settings: SearchSettings,
        seed: tuple[int, int],
        trials: int,
        *,
        constrained: bool = False,
    ) -> None:
        try:
            import optuna
        except ImportError:
            hint = 'install the extra: pip install "ldctoolkit[search]"'
            raise InputError("search.method", "needs Optuna, which is missing", value="optuna", hint=hint) from None
        self._space = space
        # a genetic algorithm recombines only the gains that all its designs have
        self._every_gain = settings.sampler == "nsga2"
        self._repeats = 0
        self._proposed: set[str] = set()
        self._margins: dict[int, tuple[float, ...]] = {}
        objectives = len(settings.objectives)
        with _quiet():
            sampler = _sampler(
                settings,
                seed,
                trials,
                conditional=bool(space.conditions),
                constraints=self._constraints if constrained else None,
            )
            self._optuna = optuna.create_study(directions=["minimize"] * objectives, sampler=sampler)

    @property
    def used_up(self) -> bool:
        """Whether nothing new is to be expected."""
        return len(self._proposed) == self._space.size or self._repeats >= _MOST_REPEATS

    def propose(self) -> tuple[Any, Design]:
        """Optuna's next trial, whose values follow later, and its design."""
        with _quiet():
            trial = self._optuna.ask()
            design = self._design(trial)
        self._repeats = self._repeats + 1 if design.id in self._proposed else 0
        self._proposed.add(design.id)
        return trial, design

    def tell(self, trial: Any, costs: tuple[float, ...] | None, margins: tuple[float, ...] = ()) -> None:
        """Tell a trial."""
        from optuna.trial import TrialState

        with _quiet():
            if costs is None:
                self._optuna.tell(trial, state=TrialState.FAIL)
            else:
                if hasattr(trial, "set_constraint"):  # since Optuna 5
                    for i, margin in enumerate(margins):
                        trial.set_constraint(str(i), margin)
                else:
                    self._margins[trial.number] = margins
                self._optuna.tell(trial, list(costs))

    def _constraints(self, trial: Any) -> tuple[float, ...]:
        """What Optuna before its version 5 requires with the values of a trial."""
        return self._margins[trial.number]

    def _design(self, trial: Any) -> Design:
        space = self._space
        values: dict[str, GainValue] = {}
        dependent = {condition.gain for condition in space.conditions}
        # the gains that conditions require come first
        for name, dimension in sorted(space.dimensions, key=lambda item: item[0] in dependent):
            if dimension.size == 1:
                values[name] = dimension.at(0.0)
            elif self._every_gain or space.holds(name, values):
                values[name] = _suggest(trial, name, dimension)
        return space.design(values)


def _suggest(trial: Any, name: str, dimension: Dimension) -> GainValue:
    if isinstance(dimension, Span):
        return _suggest_number(trial, name, dimension)
    values = dimension.values
    if len(values) > 2 and not any(isinstance(value, str | bool) for value in values):
        value_index: int = trial.suggest_int(name, 0, len(values) - 1)
        return sorted(values)[value_index]
    i: int = trial.suggest_categorical(name, range(len(values)))
    return values[i]


def _suggest_number(trial: Any, name: str, span: Span) -> float:
    log = span.scale == "log"
    sign = -1 if log and span.high < 0 else 1  # Optuna's logarithmic ranges are positive
    low, high = sorted((sign * span.low, sign * span.high))
    if span.whole:
        return int(sign * trial.suggest_int(name, int(low), int(high), log=log))
    value = rounded(sign * trial.suggest_float(name, low, high, log=log))
    return min(max(value, span.low), span.high)


def _sampler(
    settings: SearchSettings,
    seed: tuple[int, int],
    trials: int,
    *,
    conditional: bool,
    constraints: Callable[[Any], tuple[float, ...]] | None,
) -> Any:
    from optuna import samplers
    from optuna.trial import Trial

    # later ones take them with the trial, and refuse this
    before_5 = {"constraints_func": constraints} if constraints and not hasattr(Trial, "set_constraint") else {}

    short = int(np.random.SeedSequence([seed[0], _STREAM, seed[1]]).generate_state(1)[0])
    if settings.sampler == "random":
        return samplers.RandomSampler(seed=short)
    if settings.sampler == "nsga2":
        # ten generations or more; fifty is Optuna's own size
        size = min(50, max(4, trials // 10))
        return samplers.NSGAIISampler(population_size=size, seed=short, **before_5)
    single = len(settings.objectives) == 1
    return samplers.TPESampler(
        n_startup_trials=min(10, max(4, trials // 4)),
        multivariate=single,
        group=single and conditional,
        constant_liar=True,  # designs of one batch keep their distance
        seed=short,
        **before_5,
    )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Neither Optuna's log lines nor its warnings of experimental options."""
    import optuna

    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        optuna.logging.set_verbosity(before)


def run_search(campaign: Campaign) -> Sequence[Design]:
    """Run the search of a study; the designs that were tried.

    What the store holds is not run again: the same study requires the same designs.
    """
    study, store = campaign.study, campaign.store
    search = Search(study)
    stored = store.known_designs()
    while batch := search.ask():
        campaign.table.add_designs(batch)
        # what an earlier run requested is requested again: its table stays until there are more values
        if stored[: len(search.asked)] != search.asked:
            write_designs(store.folder, search.asked)
        campaign.complete(batch, f"designs {len(search.asked) - len(batch) + 1} to {len(search.asked)}")
        search.tell(*_values_and_margins(campaign, batch))
    return search.asked


_RESAMPLES = 100  # of an interval that is not used: metrics do not depend on it


def _values_and_margins(
    campaign: Campaign, batch: Sequence[Design]
) -> tuple[dict[str, Values | None], dict[str, Values]]:
    """The objectives of each design by its identifier, None for one that failed; and how far it misses requirements."""
    study, store = campaign.study, campaign.store
    values: dict[str, Values | None] = {design.id: None for design in batch}
    margins: dict[str, Values] = {}
    ran = [design for design in batch if not campaign.table.missing(design.id)]
    if not ran:
        return values, margins
    results = campaign.table.results(campaign.scenarios, store.times, {}, source=str(store.folder), designs=ran)
    ranking = Ranking.of(
        measured(results, store.measures, study.setup(), study.vehicles, study.standards),
        seed=study.seed,
        bootstrap=_RESAMPLES,
        D_y=study.report.D_y,
        setup=study.setup(),
        vehicles=study.vehicles,
        standards=study.standards,
    )
    columns = [metric_values(name, ranking) for name in study.search.objectives] if study.search else []
    requirements = requirements_of(study.ranking.require, study.plant)
    excess = [rule.excess(metric_values(rule.metric.name, ranking)) for rule in requirements]
    for i, design in enumerate(ranking.designs):
        values[design.id] = tuple(float(column[i]) for column in columns)
        margins[design.id] = tuple(float(row[i]) for row in excess)
    return values, margins


Values = tuple[float, ...]


class Search:
    """The designs of a study with ``[search]``, one batch after the other.

    Designs of tables without any choice, such as ``law = "none"``, come first. Then each law is searched for itself:
    half of the proposals go to the laws in turn, the other half to the laws of the best designs so far. A design that
    is proposed again is not run again: Optuna gets its value at once, and the proposal is no trial. A design that
    misses a requirement of the ranking is worse than every one that meets all. Raises `InputError` for a study without
    ``[search]``, and if Optuna is not installed; `UnknownNameError` for an objective that is no metric.

    Parameters
    ----------
    study : Study
        With ``[search]``; its seed and its tables decide what is proposed, together with the values of `tell`.

    Examples
    --------
    >>> block = {"law": "lqr", "gains": {"r_delta": {"from": 50, "to": 5000, "count": 9}}}
    >>> study = Study.from_dict({"name": "s", "search": {"trials": 3, "batch": 2}, "design": [block]})
    >>> search = Search(study)
    >>> while batch := search.ask():
    ...     search.tell({design.id: (dict(design.gains)["r_delta"],) for design in batch})
    >>> len(search.asked)
    3
    """

    def __init__(self, study: Study) -> None:
        if study.search is None:
            raise InputError("search", "the study has no [search] table")
        self._settings: SearchSettings = study.search
        self._signs = [1.0 if metric(name).better == "less" else -1.0 for name in self._settings.objectives]
        spaces = [space for block in study.design for space in block.space()]
        self._given = [space.design({}) for space in spaces if not space.varying]
        varying = [space for space in spaces if space.varying]
        each = math.ceil(self._settings.trials / max(len(varying), 1))
        self._requirements = len(requirements_of(study.ranking.require))
        self._laws = [
            LawSearch(space, self._settings, (study.seed, i), each, constrained=bool(self._requirements))
            for i, space in enumerate(varying)
        ]
        self._asked: dict[str, Design] = {}
        self._law_of: dict[str, int] = {}
        self._costs: dict[str, Values | None] = {}
        self._margins: dict[str, Values] = {}
        self._open: list[tuple[int, Any, str]] = []
        self._untold: dict[str, None] = {}
        self._leading: list[int] = []
        self._proposals = 0

    @property
    def asked(self) -> tuple[Design, ...]:
        """All designs so far, in the order proposed, each once."""
        return tuple(self._asked.values())

    def ask(self) -> tuple[Design, ...]:
        """The next designs, none of them proposed before; empty when there are no more.

        Raises `InputError` if values of the last batch are missing.
        """
        if self._untold:
            raise InputError("ask", f"the last batch has no values yet: {', '.join(self._untold)}")
        while len(self._untold) < self._settings.batch and len(self._asked) < self._settings.trials:
            if self._given:
                self._add(self._given.pop(0))
            elif (law := self._next_law()) is not None:
                self._propose(law)
            else:
                break
        return tuple(self._asked[name] for name in self._untold)

    def tell(self, values: Mapping[str, Values | None], margins: Mapping[str, Values] | None = None) -> None:
        """Say how good the designs of the last batch are.

        Raises `InputError` if a design of the last batch is missing, another is given, the number of objectives or of
        margins is wrong, or a margin is not a number. Nothing is taken then.

        Parameters
        ----------
        values : mapping
            ``Design.id`` -> the objectives in the study's order; None for a design that failed. A design with an
            objective that is not a number has failed too.
        margins : mapping, optional
            ``Design.id`` -> one number for each requirement of the study, above 0 where the design misses it, and the
            larger the farther it is off; designs that failed need none. Left out: all requirements are met.
        """
        for name in self._untold:
            if name not in values:
                raise InputError("tell", f"design {name} was proposed and is missing")
        for name, given in values.items():
            if name not in self._untold:
                raise InputError("tell", "is not a design of the last batch", value=name, allowed=self._untold)
            if given is not None and len(given) != len(self._signs):
                allowed = f"{len(self._signs)}, one for each objective"
                raise InputError("tell", f"design {name}: {len(given)} values", allowed=allowed)
        missed = self._checked_margins(values, margins)
        self._costs |= {name: self._as_costs(values[name]) for name in self._untold}
        self._margins |= missed
        for law, trial, name in self._open:  # in the order proposed, whatever the order of `tell`
            self._laws[law].tell(trial, self._costs[name], self._margins[name])
        self._open.clear()
        self._untold.clear()
        self._leading = self._best_laws()

    def _checked_margins(
        self, values: Mapping[str, Values | None], margins: Mapping[str, Values] | None
    ) -> dict[str, Values]:
        """The margins of every design of the last batch."""
        met = (0.0,) * self._requirements
        if margins is None:
            return dict.fromkeys(self._untold, met)
        checked = {name: met if values[name] is None else margins.get(name, ()) for name in self._untold}
        for name, given in checked.items():
            if len(given) != self._requirements or any(math.isnan(margin) for margin in given):
                allowed = f"{self._requirements} numbers, one for each requirement"
                raise InputError(f"tell: margins of design {name}", value=tuple(given), allowed=allowed)
        return {name: tuple(float(margin) for margin in given) for name, given in checked.items()}

    def _as_costs(self, values: Values | None) -> Values | None:
        if values is None or any(math.isnan(value) for value in values):
            return None
        return tuple(sign * float(value) for sign, value in zip(self._signs, values, strict=True))

    def _best_laws(self) -> list[int]:
        """The law of each design that no other dominates, in the order proposed.

        Among the designs that meet all requirements; where none does, among those that miss them by the least.
        """
        costs_of = [
            (law, costs, sum(margin for margin in self._margins[name] if margin > 0))
            for name, law in self._law_of.items()
            if (costs := self._costs.get(name)) is not None
        ]
        if not costs_of:
            return []
        least = min(missed for _, _, missed in costs_of)
        eligible = [(law, costs) for law, costs, missed in costs_of if missed == least]
        front = pareto_front(np.array([costs for _, costs in eligible]))
        return [law for (law, _), best in zip(eligible, front, strict=True) if best]

    def _next_law(self) -> int | None:
        """The law that proposes now; None when all are used up."""
        if not self._laws:
            return None
        turn, by_rank = divmod(self._proposals, 2)
        self._proposals += 1
        order: Sequence[int] = self._leading if by_rank and self._leading else range(len(self._laws))
        # the first from its place on that has something left
        from_here = [order[(turn + i) % len(order)] for i in range(len(order))]
        for law in itertools.chain(from_here, range(len(self._laws))):
            if not self._laws[law].used_up:
                return law
        return None

    def _propose(self, law: int) -> None:
        trial, design = self._laws[law].propose()
        if design.id in self._costs:
            self._laws[law].tell(trial, self._costs[design.id], self._margins[design.id])
        else:
            self._open.append((law, trial, design.id))
            self._law_of.setdefault(design.id, law)
            self._add(design)

    def _add(self, design: Design) -> None:
        if design.id not in self._asked:
            self._asked[design.id] = design
            self._untold[design.id] = None
