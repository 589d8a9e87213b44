"""The manifest of a result folder, and its tables: designs, failures, times."""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from typing import Annotated, Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ldctoolkit.checked_files import parse_json, read_regular, without_checksum
from ldctoolkit.errors import StoreError
from ldctoolkit.registry import with_content
from ldctoolkit.surroundings import machine
from ldctoolkit.vehicle import VehicleModel
from ldctoolkit.version import RECORDED, versions

from ..design import Design
from ..design_space import load_laws
from ..standards import VEHICLES
from ..study_file import Study
from ..vehicle_models import load_vehicle_model
from .checked_parts import difference_texts
from .folder_files import read_bytes, read_parquet, write_json, write_parquet

DESIGNS = "designs.parquet"


def _schema() -> dict[str, Any]:
    import polars as pl

    return {
        "design": pl.String(),
        "law": pl.String(),
        "y_s_m": pl.Float64(),
        "gains": pl.String(),
        "label": pl.String(),
        "code": pl.String(),
    }


def write_designs(folder: Path, designs: Sequence[Design]) -> None:
    """Write or replace the table: identifier, law, y_s, all gains as JSON, a label for people, content of the code."""
    import polars as pl

    rows = [(d.id, d.law, d.y_s, json.dumps(dict(d.gains)), d.label, d.code) for d in designs]
    write_parquet(folder / DESIGNS, pl.DataFrame(rows, schema=_schema(), orient="row"))


def read_designs(path: Path) -> tuple[Design, ...]:
    """The designs of a table, in its order."""
    table = read_parquet(path, _schema())
    try:
        designs = tuple(
            Design(law, y_s, tuple(parse_json(gains).items()), code)
            for _, law, y_s, gains, _, code in table.iter_rows()
        )
        wrong = [d.id for d, stored in zip(designs, table["design"], strict=True) if d.id != stored]
    except (ValueError, AttributeError) as error:
        raise StoreError(path, f"broken: {error}") from None
    if wrong:
        raise StoreError(path, f"broken: design {wrong[0]} is not what its row says")
    return designs


FAILURES = "failures.json"
TIMING_FILE = "timing.json"

Value = TypeVar("Value")

_HINTS: Final = {
    FAILURES: "it holds which designs failed, and why",
    TIMING_FILE: "it holds how long the laws took and nothing else: remove it to go on without",
}


def _read_designs_of(path: Path, kind: TypeAdapter[dict[str, Value]]) -> dict[str, Value]:
    """What a small file of a folder holds of each design, as values of a type; empty where it is missing."""
    if not path.exists():
        return {}
    data = read_bytes(path)
    try:
        return kind.validate_python(without_checksum(parse_json(data))["designs"])
    except (ValueError, TypeError, AttributeError, KeyError):
        raise StoreError(path, "broken", hint=_HINTS[path.name]) from None


def read_failures(folder: Path) -> dict[str, str]:
    """Why designs failed, of those that did; none where the file is missing."""
    return _read_designs_of(folder / FAILURES, TypeAdapter(dict[str, str]))


def write_failures(folder: Path, failures: Mapping[str, str]) -> None:
    """Write or replace the failures of a folder, sorted by design; no file where there are none."""
    path = folder / FAILURES
    if failures:
        write_json(path, {"designs": dict(sorted(failures.items()))})
    else:
        path.unlink(missing_ok=True)


@dataclasses.dataclass(frozen=True)
class LawTime:
    """Wall time inside a law's own steps."""

    seconds: float  # [s]: of all steps of one run
    commands: int  # scenarios times samples that they gave a command for

    @property
    def per_command(self) -> float:
        """Mean wall time per command [s]; 0 where no steering was needed."""
        return self.seconds / self.commands if self.commands else 0.0

    def __add__(self, other: LawTime) -> LawTime:
        """The times of two parts of a run, added."""
        return LawTime(self.seconds + other.seconds, self.commands + other.commands)


class _Time(BaseModel):
    law_seconds: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    commands: Annotated[int, Field(ge=0)]


def read_times(folder: Path) -> dict[str, LawTime]:
    """Times of the laws, of the designs for which they are known; none where the file is missing."""
    entries = _read_designs_of(folder / TIMING_FILE, TypeAdapter(dict[str, _Time]))
    return {design: LawTime(entry.law_seconds, entry.commands) for design, entry in entries.items()}


def write_times(folder: Path, times: Mapping[str, LawTime]) -> None:
    """Write or replace the times of a folder, sorted by design."""
    designs = {
        design: {"law_seconds": time.seconds, "commands": time.commands, "law_time_us": 1e6 * time.per_command}
        for design, time in sorted(times.items())
    }
    write_json(folder / TIMING_FILE, {"designs": designs})


FORMAT_VERSION: Final = 5


_AGAIN: Final = "run it into this folder again: what has changed is computed anew"


class Machine(BaseModel):
    """Where a study ran, without names of hosts or users."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    system: str
    architecture: str
    processor: str
    cores: int


class Manifest(BaseModel):
    """``manifest.json``.

    Examples
    --------
    >>> import tempfile
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = ldc.run_study(study, directory=folder, workers=1)
    ...     manifest = ldc.studies.read_manifest(folder)
    >>> manifest.read_study().name
    'small'
    """

    # "model" is the scenario model here; pydantic keeps the word for itself otherwise
    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=())

    format_version: int = FORMAT_VERSION
    study: dict[str, Any]  # Content of the study; `read_study` makes a `Study` of it
    study_hash: str  # Identity of the study
    ranked_as: str  # Identity of its ranking (`Study.ranked_as`)
    model: str  # Name of the model, or its file's name
    model_hash: str  # Content hash of the scenario model
    model_notes: tuple[str, ...] = ()  # Where the model comes from, for readers
    model_warnings: tuple[str, ...] = ()  # What its fit warned of
    model_synthetic: bool = False  # Whether it was fitted to invented driving
    inputs: dict[str, Any]  # What decides the numbers of any design
    seed: int
    laws: dict[str, str] = {}  # Content of the code of laws that are not the toolkit's
    # Where vehicle models are, and their identity, by what the study calls them
    vehicle_models: dict[str, tuple[str, str]] = {}
    versions: dict[str, str]  # Packages
    python: str
    machine: Machine
    created: str  # UTC, ISO 8601
    finished: str = ""  # The same; empty until every design is done
    wall_time_s: float = 0.0  # Summed over all runs into the folder
    executor: str = "serial"  # Where the last run's tasks ran: ``"serial"``, ``"processes"`` or ``"dask"``
    workers: int = 1  # Of the last run
    extended: tuple[str, ...] = ()  # Values that were added to the study beyond ends of sweeps, for readers
    extended_from: tuple[dict[str, Any], ...] = ()  # Its design tables without these values; none if none was added
    part_of: str = ""  # Of finalists: which ranking they are the finalists of (`Study.ranked_as`); empty otherwise
    command: str = ""  # Command line of the last run, absolute paths reduced to file names

    @classmethod
    def of(
        cls,
        study: Study,
        *,
        model: str,
        model_hash: str,
        model_notes: tuple[str, ...],
        model_synthetic: bool,
        model_warnings: tuple[str, ...] = (),
        part_of: str = "",
        extended: tuple[str, ...] = (),
        extended_from: Sequence[dict[str, Any]] = (),
    ) -> Manifest:
        """The manifest of a study that starts now."""
        content = study.content()
        for key in ("model", "departures", "table"):
            content["scenarios"][key] = PurePath(content["scenarios"][key]).name
        return cls(
            study=content,
            study_hash=study.hash,
            ranked_as=study.ranked_as,
            model=PurePath(model).name,
            model_hash=model_hash,
            model_notes=model_notes,
            model_warnings=model_warnings,
            model_synthetic=model_synthetic,
            part_of=part_of,
            extended=extended,
            extended_from=tuple(extended_from) if extended else (),
            inputs=study.inputs(),
            seed=study.seed,
            laws=study.laws(),
            vehicle_models={
                name: ((study.folder / name).resolve().as_posix(), model.identity)
                for name, model in study.vehicle_models.items()
            },
            versions=dict(versions(RECORDED)),
            python=platform.python_version(),
            machine=Machine(**machine()),
            created=_now(),
            command=_command(sys.argv),
        )

    def resumed(self, fresh: Manifest) -> Manifest:
        """The same with the settings of a new run into the same folder."""
        return fresh.model_copy(update={"created": self.created, "wall_time_s": self.wall_time_s})

    def ended(self, *, seconds: float, executor: str, workers: int, complete: bool) -> Manifest:
        """The same after a run."""
        update = {
            "wall_time_s": self.wall_time_s + seconds,
            "executor": executor,
            "workers": workers,
            "finished": _now() if complete else "",
        }
        return self.model_copy(update=update)

    def other_versions(self) -> str:
        """Packages that decide numbers and had other versions then; empty for none."""
        compared = ((name, self.versions.get(name, "not installed"), now) for name, now in versions())
        return ", ".join(f"{name} {was} (now {now})" for name, was, now in compared if was != now)

    def read_study(self, *, current: bool = True) -> Study:
        """The study that was run, with the classes of its laws.

        Raises `StoreError` if their code is another than then; without `current` the stored numbers can be read, but
        nothing can be driven again.
        """
        if not current:
            return Study.from_dict(self._without_models(), source="study")
        load_laws(self.study, Path(), {})
        classes: dict[str, Any] = {name: with_content(name, content) for name, content in self.laws.items()}
        changed = [name for name, kind in classes.items() if kind is None]
        models: dict[str, VehicleModel] = {}
        for name, (place, identity) in self.vehicle_models.items():
            text = load_vehicle_model("vehicle model", place if ".py:" in name else name, Path(), models)
            models[name] = models[text]
            if models[name].identity != identity:
                raise StoreError(f"vehicle model {name!r}", "its code has changed since the study was run", hint=_AGAIN)
        if not changed:
            study = Study.from_dict(self.study, source="study", classes=classes, models=models)
            # a law inside another is the present one of its name
            changed = [name for name, content in study.laws().items() if self.laws.get(name) != content]
        if changed:
            raise StoreError(f"law {changed[0]!r}", "its code has changed since the study was run", hint=_AGAIN)
        return study

    def _without_models(self) -> dict[str, Any]:
        """The study without vehicle models, to read its numbers alone."""
        vehicle = {key: value for key, value in self.study["vehicle"].items() if key != "model"}
        names = [name for name in self.study["ranking"]["vehicles"] if name in VEHICLES]
        return self.study | {"vehicle": vehicle, "ranking": self.study["ranking"] | {"vehicles": names}}


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _command(arguments: Sequence[str]) -> str:
    """The command line as text that can be typed again, without absolute paths."""
    return shlex.join(["ldc", *(_relative(word) for word in arguments[1:])])


def _relative(word: str) -> str:
    """The word with an absolute path in it cut to its last part: alone, or after ``-o`` or ``--output=``."""
    for start in (0, 2, word.find("=") + 1):
        if (start == 0 or word.startswith("-")) and PurePath(word[start:]).is_absolute():
            return word[:start] + PurePath(word[start:]).name
    return word


def refuse_other(folder: Path, former: Manifest, manifest: Manifest) -> None:
    """Raise a `StoreError` that says what differs if two manifests do not belong to the same numbers."""
    differing = difference_texts(former.inputs, manifest.inputs)
    if former.model_hash != manifest.model_hash:
        was, now = (f"{m.model} (content {m.model_hash[:12]})" for m in (former, manifest))
        differing.insert(0, f"model: {was} there, {now} now")
    if differing:
        name = former.study.get("name", "?")
        raise StoreError(folder, f"holds another study ({name}): {'; '.join(differing)}", hint="choose another folder")


def read_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of a study's folder.

    Raises `StoreError` if there is none, or it is broken or of another format.

    Parameters
    ----------
    folder : path

    Examples
    --------
    >>> import tempfile
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = ldc.run_study(study, directory=folder, workers=1)
    ...     manifest = ldc.studies.read_manifest(folder)
    >>> manifest.read_study() == study
    True
    """
    path = Path(folder) / "manifest.json"
    if not os.path.exists(path):  # noqa: PTH110 - this one raises nothing, whatever the path
        raise StoreError(folder, "is not the folder of a study (it holds no manifest.json)")
    hint = "run the study into another folder"
    try:
        content = parse_json(read_regular(path, StoreError))
        version = content["format_version"]
        if version != FORMAT_VERSION:
            if isinstance(version, int) and version > FORMAT_VERSION:
                hint = "the folder is newer, update ldctoolkit"
            raise StoreError(f"{path}: format_version", value=version, allowed=str(FORMAT_VERSION), hint=hint)
        return Manifest.model_validate(without_checksum(content))
    except ValidationError as error:
        problem = "; ".join(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors())
    except (ValueError, KeyError, TypeError) as error:
        problem = str(error)
    raise StoreError(path, f"broken: {problem}", hint=hint)


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write or replace the manifest of a folder."""
    write_json(folder / "manifest.json", manifest.model_dump(mode="json"), indent=2)
