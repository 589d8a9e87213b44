"""The folder beside an extraction's output in which finished parts wait for the others."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import logging
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.departures import Departures, ExtraColumn
from ldctoolkit.errors import StoreError, plain
from ldctoolkit.recordings.account import Account, Origin
from ldctoolkit.recordings.drawn import Drawn, DrawnEvent
from ldctoolkit.recordings.evidence import Evidence
from ldctoolkit.recordings.recording import Label, Problem
from ldctoolkit.recordings.result import PartResult
from studies.extraction.plan import Plan, what_differs
from studies.storage.files import locked, read_bytes, remove_leftovers, stored_file, write_text

_log = logging.getLogger("studies")

SUFFIX: Final = ".parts"
"""Of the folder's name, after the name of the output."""

_MANIFEST: Final = "manifest.json"
_LOCK: Final = ".lock"
_PART = re.compile(r"part-(\d+)-([0-9a-f]{16})\.npz")
_DIGITS: Final = 16


class WorkFolder:
    """Finished parts of one extraction. Made by `work_folder`, which holds it for this process. A part's name has its
    number and a checksum of its content: a file that was cut short or has a flipped bit is found out, and the part
    is read again.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parts: dict[int, Path] = {}
        for file in sorted(path.iterdir()):
            found = _PART.fullmatch(file.name)
            if found is not None:
                self._take_in(int(found[1]), file, found[2])

    def _take_in(self, number: int, file: Path, checksum: str) -> None:
        # all are read once here, so that what is missing is known before anything is computed
        content = read_bytes(file)
        try:
            if _checksum(content) != checksum:
                raise StoreError("broken: its content is not what was written (the checksum in its name differs)")
            read_part(content)
        except StoreError as error:
            _log.warning("%s: %s; this part is read again", file, error)
            _unlink(file)
        else:
            self._parts[number] = file

    @property
    def finished(self) -> frozenset[int]:
        """Numbers of the parts that are there."""
        return frozenset(self._parts)

    def write(self, number: int, result: PartResult) -> None:
        """Store a part, whole or not at all."""
        content = part_bytes(result)
        path = self.path / f"part-{number:06d}-{_checksum(content)}.npz"
        with stored_file(path) as stream:
            stream.write(content)
        self._parts[number] = path

    def read(self, number: int) -> PartResult:
        """A part that is there."""
        path = self._parts[number]
        content = read_bytes(path)
        if not path.stem.endswith(_checksum(content)):
            raise StoreError(f"{path}: changed while parts were read; run it again to go on")
        return read_part(content)

    def remove(self) -> None:
        """Remove everything that this program wrote, and the folder if nothing else is in it."""
        _clear(self.path)
        _unlink(self.path / _LOCK)
        with contextlib.suppress(OSError):
            self.path.rmdir()


def parts_folder(output: str | os.PathLike[str]) -> Path:
    """Where the finished parts of an extraction wait.

    Examples
    --------
    >>> parts_folder("d.parquet").name
    'd.parquet.parts'
    """
    return Path(f"{os.fspath(output)}{SUFFIX}")


def holds_parts(path: Path) -> bool:
    """Whether a folder is there that an extraction has left, whatever it was of."""
    try:
        return (path / _MANIFEST).is_file()
    except OSError:  # nobody may look
        return False


@contextlib.contextmanager
def work_folder(path: Path, plan: Plan) -> Iterator[WorkFolder]:
    """Hold a work folder, made if need be, with the parts of the same plan that are in it. Parts of another plan are
    removed, with a warning that says what differs. A folder without a finished part is removed when the block ends
    in an error.
    """
    try:
        path.mkdir(exist_ok=True)
    except FileExistsError:
        raise StoreError(
            f"{path}: is no folder; finished parts are kept there: move it, or choose another output"
        ) from None
    except OSError as error:
        raise StoreError(f"{path}: cannot be made: {error.strerror or error}") from None
    with locked(path):
        try:
            remove_leftovers(path)
            _keep_only(path, plan)
            folder = WorkFolder(path)
        except OSError as error:  # the run that held it may have ended, and taken it away, at this moment
            raise StoreError(f"{path}: cannot be used: {error.strerror or error}") from None
        try:
            yield folder
        except BaseException:
            if not folder.finished:
                folder.remove()
            raise


def _keep_only(path: Path, plan: Plan) -> None:
    """Leave nothing in the folder but parts of this plan, and the plan itself."""
    manifest = path / _MANIFEST
    if manifest.exists():
        try:
            there = json.loads(read_bytes(manifest))
            differs = what_differs(there, plan) if isinstance(there, dict) else "its manifest is broken"
        except ValueError:
            differs = "its manifest is broken"
        if not differs and plan["files"]:  # without digests nobody knows whether the files are the same
            return
        if any(_PART.fullmatch(file.name) for file in path.iterdir()):
            _log.warning(
                "%s: its parts are of another extraction and are removed (%s)",
                path,
                differs or "the files are not known",
            )
        _clear(path)
    else:
        others = [file.name for file in path.iterdir() if file.name != _LOCK and not _PART.fullmatch(file.name)]
        if others:
            raise StoreError(
                f"{path}: is not the work folder of an extraction (it holds {sorted(others)[0]}); finished parts are "
                "kept there: move it, or choose another output"
            )
        _clear(path)
    write_text(manifest, json.dumps(plan, indent=1, ensure_ascii=False) + "\n")


def _clear(path: Path) -> None:
    """Remove parts and manifest; the manifest first, so that no part is ever taken for one of another plan."""
    if not path.is_dir():
        return  # removed before
    _unlink(path / _MANIFEST)
    for file in list(path.iterdir()):
        if _PART.fullmatch(file.name):
            _unlink(file)


def _unlink(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(f"{path}: cannot be removed: {error.strerror or error}") from None


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]


_CLASSES: Final[dict[str, Any]] = {
    kind.__name__: kind
    for kind in (
        PartResult, Departures, ExtraColumn, Account, Origin, Label, Evidence, Drawn, DrawnEvent, Problem,
    )
}  # fmt: skip
"""Everything that a result is made of."""

_TREE: Final = "tree"
"""Entry that holds the JSON."""


def part_bytes(result: PartResult) -> bytes:
    """A result as the content of a file."""
    arrays: list[np.ndarray[Any, Any]] = []
    text = json.dumps(_packed(result, arrays), ensure_ascii=False)
    content = io.BytesIO()
    entries = {str(i): array for i, array in enumerate(arrays)}
    np.savez(content, allow_pickle=False, **{_TREE: np.frombuffer(text.encode(), dtype=np.uint8)}, **entries)
    return content.getvalue()


def read_part(content: bytes) -> PartResult:
    """The result that `part_bytes` made the content of."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as entries:
            tree = json.loads(entries[_TREE].tobytes().decode())
            result = _unpacked(tree, entries)
    except Exception as error:  # any byte of it may be another
        raise StoreError(f"broken: {error or type(error).__name__}") from None
    if not isinstance(result, PartResult):
        raise StoreError(f"broken: holds {type(result).__name__}")
    return result


def _packed(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    """A tree of what JSON knows; arrays are put aside and named by their place."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if dataclasses.is_dataclass(value) and type(value).__name__ in _CLASSES:
        fields = {field.name: _packed(getattr(value, field.name), arrays) for field in dataclasses.fields(value)}
        return {"class": type(value).__name__, "fields": fields}
    if isinstance(value, tuple):
        return [_packed(item, arrays) for item in value]
    return plain(value)


def _unpacked(value: Any, arrays: Any) -> Any:
    if isinstance(value, list):
        return tuple(_unpacked(item, arrays) for item in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[str(value["array"])]
    return _CLASSES[value["class"]](**{name: _unpacked(item, arrays) for name, item in value["fields"].items()})
