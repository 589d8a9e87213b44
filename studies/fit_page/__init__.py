"""The page that tells how well a scenario model fits: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy.typing as npt

    from ldctoolkit.departures import Departures
    from ldctoolkit.scenario_model import ScenarioModel

__all__ = ["write_fit_page"]


def write_fit_page(
    target: Path,
    model: ScenarioModel,
    departures: Departures,
    *,
    seed: int = 0,
    weights: npt.ArrayLike | None = None,
    png: Path | None = None,
    drawn: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Check a scenario model against departures and write what was found as one HTML file that needs nothing else.

    Parameters
    ----------
    target : Path
        File to write; whole or not at all.
    model : ScenarioModel
        The fitted model.
    departures : Departures
        What it was fitted to, both sides together.
    seed : int
        Seed of model samples and the split of the comparison.
    weights : (n,), optional
        Events that each departure stands for, as in the fit.
    png : Path, optional
        Also write a summary as one picture there.
    drawn : bool
        Whether the departures are only some of those that the model was fitted to, drawn at random; the page says so.
    progress : callable, optional
        Called as ``progress("left: held-out likelihood", done, total)``.

    Raises
    ------
    InputError
        If a side holds too few departures inside the model's bounds.
    StoreError
        If a file cannot be written.
    """
    # templates and plots take a second to import; a command that writes no page should not wait for them
    from studies.fit_page.page import write_page

    write_page(Path(target), model, departures, seed=seed, weights=weights, png=png, drawn=drawn, progress=progress)
