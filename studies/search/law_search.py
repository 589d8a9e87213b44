"""Optuna on the space of one law: proposes designs and hears what they cost."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from ldctoolkit.errors import InputError
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.design_space.dimensions import Choices, Dimension, Span, rounded
from studies.design_space.law_space import LawSpace
from studies.study_file.ranking_settings import SearchSettings

_STREAM: Final = 0x73656172
"""Of the random numbers of a search."""

_MOST_REPEATS: Final = 100
"""So many known designs in a row: the sampler has nothing new to propose."""


class LawSearch:
    """The search within one law.

    Parameters
    ----------
    space : LawSpace
        With a dimension that varies.
    settings : SearchSettings
    seed : tuple of int
        The study's, and the number of the space.
    trials : int
        About so many designs will be proposed.

    Raises
    ------
    InputError
        If Optuna is not installed.
    """

    def __init__(self, space: LawSpace, settings: SearchSettings, seed: tuple[int, int], trials: int) -> None:
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
        objectives = len(settings.objectives)
        with _quiet():
            sampler = _sampler(settings, seed, trials, conditional=bool(space.conditions))
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

    def tell(self, trial: Any, costs: tuple[float, ...] | None) -> None:
        """Tell a trial.

        Parameters
        ----------
        trial : optuna.Trial
        costs : tuple of float or None
            One for each objective, smaller is better; None for a design that failed.
        """
        from optuna.trial import TrialState

        with _quiet():
            if costs is None:
                self._optuna.tell(trial, state=TrialState.FAIL)
            else:
                self._optuna.tell(trial, list(costs))

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


def _sampler(settings: SearchSettings, seed: tuple[int, int], trials: int, *, conditional: bool) -> Any:
    from optuna import samplers

    short = int(np.random.SeedSequence([seed[0], _STREAM, seed[1]]).generate_state(1)[0])
    if settings.sampler == "random":
        return samplers.RandomSampler(seed=short)
    if settings.sampler == "nsga2":
        # ten generations or more; fifty is Optuna's own size
        return samplers.NSGAIISampler(population_size=min(50, max(4, trials // 10)), seed=short)
    single = len(settings.objectives) == 1
    return samplers.TPESampler(
        n_startup_trials=min(10, max(4, trials // 4)),
        multivariate=single,
        group=single and conditional,
        constant_liar=True,  # designs of one batch keep their distance
        seed=short,
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
