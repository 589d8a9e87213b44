"""The manifest of a study's folder: what was asked for, with which versions, on which machine."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import os
import platform
import shlex
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, ValidationError

import ldctoolkit
from ldctoolkit.errors import StoreError, StudyError
from studies.storage.files import write_text
from studies.study_file import Study

FORMAT_VERSION: Final = 3

_PACKAGES: Final = (
    "ldctoolkit",
    "numpy",
    "scipy",
    "polars",
    "pydantic",
    "casadi",
    "control",
    "osqp",
    "qpsolvers",
    "numba",
    "loky",
)


class Machine(BaseModel):
    """Where a study ran, without names of hosts or users."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    system: str
    architecture: str
    processor: str
    cores: int


class Manifest(BaseModel):
    """``manifest.json``.

    Attributes
    ----------
    format_version : int
    study : dict
        Content of the study; `read_study` makes a `Study` of it.
    study_hash, model_hash : str
        Identity of the study and content hash of the scenario model.
    model : str
        Name of the model, or its file's name.
    model_notes : tuple of str
        Where the model comes from, for readers.
    model_synthetic : bool
        Whether it was fitted to invented driving.
    inputs : dict
        What decides the numbers of any design.
    seed : int
    versions : dict of str to str
        Packages.
    python : str
    machine : Machine
    created, finished : str
        UTC, ISO 8601; `finished` is empty until every design is done.
    wall_time_s : float
        Summed over all runs into the folder.
    executor : str
        Where the last run's tasks ran: ``"serial"``, ``"processes"`` or ``"dask"``.
    workers : int
        Of the last run.
    part_of : str
        Of finalists: which ranking they are the finalists of (`Study.ranked_as`); empty otherwise.
    command : str
        Command line of the last run, absolute paths reduced to file names.
    """

    # "model" is the scenario model here; pydantic keeps the word for itself otherwise
    model_config = ConfigDict(extra="forbid", frozen=True, protected_namespaces=())

    format_version: int = FORMAT_VERSION
    study: dict[str, Any]
    study_hash: str
    model: str
    model_hash: str
    model_notes: tuple[str, ...] = ()
    model_synthetic: bool = False
    inputs: dict[str, Any]
    seed: int
    versions: dict[str, str]
    python: str
    machine: Machine
    created: str
    finished: str = ""
    wall_time_s: float = 0.0
    executor: str = "serial"
    workers: int = 1
    part_of: str = ""
    command: str = ""

    @classmethod
    def of(
        cls,
        study: Study,
        *,
        model: str,
        model_hash: str,
        model_notes: tuple[str, ...],
        model_synthetic: bool,
        part_of: str = "",
    ) -> Manifest:
        """The manifest of a study that starts now."""
        content = study.content()
        content["scenarios"]["model"] = PurePath(content["scenarios"]["model"]).name
        return cls(
            study=content,
            study_hash=study.hash,
            model=PurePath(model).name,
            model_hash=model_hash,
            model_notes=model_notes,
            model_synthetic=model_synthetic,
            part_of=part_of,
            inputs=study.inputs(),
            seed=study.seed,
            versions=_versions(),
            python=platform.python_version(),
            machine=Machine(
                system=f"{platform.system()} {platform.release()}",
                architecture=platform.machine(),
                processor=_processor(),
                cores=os.cpu_count() or 1,
            ),
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

    def read_study(self) -> Study:
        """The study that was run; one from before there was a choice has the printed start."""
        simulation = self.study.get("simulation")
        given = {"simulation": {"start": "printed", **simulation}} if isinstance(simulation, dict) else {}
        return Study.from_dict(self.study | given, source="manifest.json: study")


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    found["ldctoolkit"] = ldctoolkit.__version__
    return found


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass  # not Linux
    return platform.processor()


def _command(arguments: Sequence[str]) -> str:
    """The command line in words that can be typed again, without absolute paths."""
    return shlex.join(["ldc", *(_relative(word) for word in arguments[1:])])


def _relative(word: str) -> str:
    """The word with an absolute path in it cut to its last part: alone, or after ``-o`` or ``--output=``."""
    for start in (0, 2, word.find("=") + 1):
        if (start == 0 or word.startswith("-")) and PurePath(word[start:]).is_absolute():
            return word[:start] + PurePath(word[start:]).name
    return word


def refuse_other(folder: Path, found: Manifest, wanted: Manifest) -> None:
    """Raise a `StoreError` that says what differs if two manifests do not belong to the same numbers."""
    differing = list(differences(found.inputs, wanted.inputs))
    if found.model_hash != wanted.model_hash:
        was, now = (f"{m.model} (content {m.model_hash[:12]})" for m in (found, wanted))
        differing.insert(0, f"model: {was} there, {now} now")
    was, now = (m.versions.get("ldctoolkit", "?") for m in (found, wanted))
    if was != now:
        differing.append(f"ldctoolkit: {was} there, {now} now")
    if differing:
        name = found.study.get("name", "?")
        raise StoreError(f"{folder}: holds another study ({name}): {'; '.join(differing)}; choose another folder")


def differences(found: dict[str, Any], wanted: dict[str, Any], prefix: str = "") -> Iterable[str]:
    """What differs between two `Manifest.inputs`, one text ``"key: X there, Y now"`` each."""
    for key in {**found, **wanted}:
        a, b = found.get(key), wanted.get(key)
        if a == b:
            continue
        if isinstance(a, dict) and isinstance(b, dict):
            yield from differences(a, b, f"{prefix}{key}.")
        else:
            was, now = ("not set" if value is None else repr(value) for value in (a, b))
            yield f"{prefix}{key}: {was} there, {now} now"


def read_manifest(folder: str | Path) -> Manifest:
    """Read the manifest of a study's folder.

    Parameters
    ----------
    folder : path

    Returns
    -------
    Manifest

    Raises
    ------
    StoreError
        If there is none, or it is broken or of another format.
    """
    path = Path(folder) / "manifest.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version = content["format_version"]
        if version != FORMAT_VERSION:
            raise StoreError(f"{path}: format {version!r}; this version reads {FORMAT_VERSION}")
        manifest = Manifest.model_validate(content)
        manifest.read_study()
    except FileNotFoundError:
        raise StoreError(f"{folder}: holds no study (no manifest.json)") from None
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, StudyError | ValidationError):
            error = ValueError(str(error).replace("\n", " "))
        raise StoreError(f"{path}: broken: {error}") from None
    return manifest


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write or replace the manifest of a folder."""
    write_text(folder / "manifest.json", manifest.model_dump_json(indent=2) + "\n")
