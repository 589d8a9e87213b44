"""Optuna on the space of one law: proposes designs and hears what they cost."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from ldctoolkit.errors import InputError
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.design_space.law_space import Choices, Dimension, LawSpace, Span, rounded
from studies.study_file.ranking_settings import SearchSettings

_STREAM: Final = 0x73656172
"""Of the random numbers of a search."""

_MOST_REPEATS: Final = 100
"""So many known designs in a row: the sampler has nothing new to propose."""


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
            message = "search.method: 'optuna' needs Optuna, which is not installed"
            raise InputError(f'{message}; install the extra: pip install "ldctoolkit[search]"') from None
        self._space = space
        # a genetic algorithm recombines only the gains that all its designs have
        self._every_gain = settings.sampler == "nsga2"
        self._repeats = 0
        self._found: set[str] = set()
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
        return len(self._found) == self._space.size or self._repeats >= _MOST_REPEATS

    def propose(self) -> tuple[Any, Design]:
        """Optuna's next trial, which is to be told later, and its design."""
        with _quiet():
            trial = self._optuna.ask()
            design = self._design(trial)
        self._repeats = self._repeats + 1 if design.id in self._found else 0
        self._found.add(design.id)
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
        """What Optuna before its version 5 asks for when a trial is told."""
        return self._margins[trial.number]

    def _design(self, trial: Any) -> Design:
        space = self._space
        values: dict[str, GainValue] = {}
        dependent = {condition.gain for condition in space.conditions}
        # the gains that conditions ask for come first
        for name, dimension in sorted(space.dimensions, key=lambda one: one[0] in dependent):
            if dimension.size == 1:
                values[name] = dimension.at(0.0)
            elif self._every_gain or space.holds(name, values):
                values[name] = _suggest(trial, name, dimension)
        return space.design(values)


def _suggest(trial: Any, name: str, dimension: Dimension) -> GainValue:
    if isinstance(dimension, Span):
        return _suggest_number(trial, name, dimension)
    values = dimension.values
    if _ordered(dimension):
        place: int = trial.suggest_int(name, 0, len(values) - 1)
        return sorted(values)[place]
    chosen: int = trial.suggest_categorical(name, range(len(values)))
    return values[chosen]


def _ordered(choices: Choices) -> bool:
    """Whether the values are numbers, so many that a sampler can use their order."""
    return len(choices.values) > 2 and not any(isinstance(value, str | bool) for value in choices.values)


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

    # later ones are told with the trial, and refuse this
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
