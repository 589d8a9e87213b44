"""Scenario model: one bounded Gaussian mixture a side, from which scenarios are drawn; one JSON file."""

from __future__ import annotations

import dataclasses
import datetime
import importlib.resources
import json
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import _scenario_json as form
from ldctoolkit._scenario_fit import LEAST_EVENTS, checked_bounds, fit_side
from ldctoolkit._scenario_parts import PHYSICAL_BOUNDS, ModelProvenance, SideModel, SideSummary
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Departures
from ldctoolkit.errors import InputError, ModelError, UnknownNameError, nearest
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture.bounded_gaussian_mixture import SAMPLE_BLOCK
from ldctoolkit.scenarios import SPEED_FLOOR, Scenarios, slowest_speed

__all__ = [
    "PHYSICAL_BOUNDS",
    "ModelProvenance",
    "ScenarioModel",
    "SideModel",
    "SideSummary",
    "bundled_models",
    "fit_scenario_model",
    "load_model",
]

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]

_STREAM: Final = {LEFT: 0, RIGHT: 1}
_SPARE_BLOCKS: Final = 50
"""Blocks drawn per block needed before sampling is given up: one event in fifty must stay above the speed floor."""

_REPORT_BLOCKS: Final = 10


@dataclasses.dataclass(frozen=True)
class ScenarioModel:
    """Left and right mixture, their bounds, constants and provenance.

    Attributes
    ----------
    left_side, right_side : SideModel
        Mixture over the parameters that vary, and the constants.
    provenance : ModelProvenance
        Where the model comes from.

    Notes
    -----
    Parameters are in the outward frame, SI units, in the order of ``PARAMETER_NAMES``.

    Examples
    --------
    >>> model = load_model("reference")
    >>> scenarios = model.sample(3, 2, seed=1)
    >>> scenarios.side.tolist()
    [1, 1, 1, -1, -1]
    """

    left_side: SideModel
    right_side: SideModel
    provenance: ModelProvenance

    @property
    def left(self) -> BoundedGaussianMixture:
        """Mixture of left departures, over ``left_side.names``."""
        return self.left_side.mixture

    @property
    def right(self) -> BoundedGaussianMixture:
        """Mixture of right departures, over ``right_side.names``."""
        return self.right_side.mixture

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that sampling depends on; the same for two fits that gave the same numbers."""
        return form.content_hash(self.left_side, self.right_side)

    def sample(self, n_left: int, n_right: int, seed: int) -> Scenarios:
        """Draw scenarios, left ones first.

        Parameters
        ----------
        n_left, n_right : int
            Number of scenarios a side.
        seed : int
            The same seed gives the same scenarios; the first m scenarios of a side depend neither on how many are
            drawn nor on the other side.

        Returns
        -------
        Scenarios
            n_left + n_right rows inside the model's bounds.

        Raises
        ------
        InputError
            If a number or the seed is not a non-negative integer.
        ModelError
            If hardly any event of the model can be replayed.

        Notes
        -----
        Events are drawn in blocks of 1,024, each from its own random stream (seed, side, block). An event whose speed
        falls below ``SPEED_FLOOR`` within the departure is passed over and the next one of the stream taken; the
        share of such events is ``provenance.left.redrawn_share``, or by `redrawn_share`.
        """
        parts = [
            self._draw(side, _whole(name, n), _whole("seed", seed))
            for side, name, n in ((LEFT, "n_left", n_left), (RIGHT, "n_right", n_right))
        ]
        columns = {name: np.concatenate([part[name] for part in parts]) for name in PARAMETER_NAMES}
        return Scenarios.from_arrays(side=np.repeat([LEFT, RIGHT], [n_left, n_right]), **columns)

    def _block(self, side: int, block: int, seed: int) -> dict[str, FloatArray]:
        """The events of one block that can be replayed."""
        half = self.left_side if side == LEFT else self.right_side
        x, _ = half.mixture.sample_block(seed, (_STREAM[side], block))
        columns = half.columns(x)
        keep = slowest_speed(columns["v_mean"], columns["a_mean"], columns["T"]) >= SPEED_FLOOR
        return {name: column[keep] for name, column in columns.items()}

    def _draw(self, side: int, n: int, seed: int) -> dict[str, FloatArray]:
        blocks: list[dict[str, FloatArray]] = []
        found = 0
        limit = _SPARE_BLOCKS * (1 + n // SAMPLE_BLOCK)
        while found < n:
            if len(blocks) == limit:
                share = 1.0 - found / (limit * SAMPLE_BLOCK)
                word = "left" if side == LEFT else "right"
                raise ModelError(
                    f"scenario model ({word}): {share:.1%} of the events fall below {SPEED_FLOOR} m/s and cannot be "
                    "replayed; the model does not describe driving at speed"
                )
            blocks.append(self._block(side, len(blocks), seed))
            found += blocks[-1]["T"].size
        if not blocks:
            return {name: np.empty(0) for name in PARAMETER_NAMES}
        return {name: np.concatenate([block[name] for block in blocks])[:n] for name in PARAMETER_NAMES}

    def redrawn_share(self, side: int, seed: int = 0) -> float:
        """Share of events of a side (LEFT or RIGHT) below the speed floor, from 10,240 draws."""
        kept = sum(self._block(side, block, seed)["T"].size for block in range(_REPORT_BLOCKS))
        return 1.0 - kept / (_REPORT_BLOCKS * SAMPLE_BLOCK)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write one JSON file, whole or not at all.

        Parameters
        ----------
        path : path
            An existing file is replaced.

        Raises
        ------
        ModelError
            If the file cannot be written, or the provenance holds values that JSON does not know.
        """
        target = Path(path)
        try:
            data = form.model_to_json(self.left_side, self.right_side, self.provenance)
            text = json.dumps(data, indent=1, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ModelError(f"{target.name}: the model cannot be written as JSON ({error})") from None
        part = target.with_name(f".{target.name}.{os.getpid()}.part")
        try:
            part.write_text(text + "\n", encoding="utf-8")
            part.replace(target)
        except OSError as error:
            raise ModelError(f"{target}: cannot write the scenario model ({error.strerror})") from None
        finally:
            part.unlink(missing_ok=True)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> ScenarioModel:
        """Read and check a file written by `save`.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        ScenarioModel
            With exactly the numbers that were saved.

        Raises
        ------
        ModelError
            Broken JSON (with line and column), another format or version, or a value that does not fit (with its key
            path).
        """
        return cls._parse(form.read_text(Path(path)), str(path))

    @classmethod
    def _parse(cls, text: str, file: str) -> ScenarioModel:
        return cls(*form.model_from_json(form.read_json(text, file), file))


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise InputError(f"{name}: {value!r}; allowed: an integer >= 0")
    return int(value)


def bundled_models() -> tuple[str, ...]:
    """Names of the models that come with the toolkit.

    Examples
    --------
    >>> bundled_models()
    ('reference',)
    """
    folder = importlib.resources.files("ldctoolkit") / "models"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".json")))


def load_model(name_or_path: str | os.PathLike[str]) -> ScenarioModel:
    """A bundled model by its name, or a model file by its path.

    Parameters
    ----------
    name_or_path : str or path
        ``"reference"``, or a path to a JSON file.

    Returns
    -------
    ScenarioModel
        The model.

    Raises
    ------
    UnknownNameError
        If it is neither a bundled name nor a file; the message lists the names.
    ModelError
        If the file is broken.

    Examples
    --------
    >>> load_model("reference").provenance.synthetic
    True
    """
    name = os.fspath(name_or_path)
    names = bundled_models()
    if name in names:
        text = (importlib.resources.files("ldctoolkit") / "models" / f"{name}.json").read_text(encoding="utf-8")
        return ScenarioModel._parse(text, f"{name}.json")
    path = Path(name)
    if path.exists():
        return ScenarioModel.load(path)
    if path.suffix == ".json" or path.name != name or not isinstance(name_or_path, str):
        raise ModelError(f"{name}: no such file; bundled models: {', '.join(names)}")
    raise UnknownNameError(f"scenario model {name!r}: neither a bundled model nor a file; {nearest(name, names)}")


def fit_scenario_model(
    departures: Departures,
    *,
    components: int | Iterable[int] = range(1, 11),
    seed: int = 0,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    source_provenance: Mapping[str, Any] | str = "",
    synthetic: bool = False,
    progress: Progress | None = None,
) -> ScenarioModel:
    """Fit a scenario model to departures: one mixture a side, the number of components by BIC.

    Parameters
    ----------
    departures : Departures
        Both sides together.
    components : int or iterable of int
        K, or the K to choose from. A range is cut where the events no longer carry it (two events a free parameter).
    seed : int
        Seed of the fits.
    bounds : mapping, optional
        Parameter name -> (lower, upper) in SI units, in place of the entry in ``PHYSICAL_BOUNDS``.
    source_provenance : mapping or str
        JSON values that describe the data, kept in the model.
    synthetic : bool
        Whether the departures were drawn and not recorded.
    progress : callable, optional
        Called as ``progress("left: K = 3", done, total)``, first for the left side and then for the right one.

    Returns
    -------
    ScenarioModel
        What a user should know (constant parameters, values on a bound, a cut range) is in ``provenance.warnings``.

    Raises
    ------
    InputError
        Fewer than 30 departures on a side (the message gives both counts), a value outside the bounds, or a setting
        out of range.

    Notes
    -----
    A parameter with the same value in every event of a side is left out of the mixture and kept as a constant. A
    value exactly on a bound is moved inside by half the smallest other distance to it, at most a thousandth of the
    column's standard deviation.
    """
    seed = _whole("seed", seed)
    box = checked_bounds(bounds)
    wanted = components if isinstance(components, int) else tuple(components)
    rows = {"left": departures.side == LEFT, "right": departures.side == RIGHT}
    counts = {label: int(mask.sum()) for label, mask in rows.items()}
    if min(counts.values()) < LEAST_EVENTS:
        raise InputError(
            f"departures: {counts['left']} left and {counts['right']} right; allowed: at least {LEAST_EVENTS} a side"
        )
    fits = {label: fit_side(departures.take(mask), label, wanted, seed, box, progress) for label, mask in rows.items()}
    source = {"description": source_provenance} if isinstance(source_provenance, str) else source_provenance
    from ldctoolkit.version import __version__

    provenance = ModelProvenance(
        source=source,
        synthetic=synthetic,
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        software=f"ldctoolkit {__version__}",
        seed=seed,
        warnings=tuple(note for fit in fits.values() for note in fit.warnings),
    )
    model = ScenarioModel(fits["left"].side, fits["right"].side, provenance)
    left, right = (
        dataclasses.replace(fits[label].summary, redrawn_share=model.redrawn_share(side))
        for label, side in (("left", LEFT), ("right", RIGHT))
    )
    return dataclasses.replace(model, provenance=dataclasses.replace(provenance, left=left, right=right))
