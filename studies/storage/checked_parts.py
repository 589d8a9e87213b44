"""Finished parts of a long computation: files of a folder that is planned and locked, so that a stopped run goes on.

A part is written whole or not at all. Its name holds a checksum of its content, which is checked when it is read.
"""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import hashlib
import importlib
import json
import logging
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.checked_files import write_whole
from ldctoolkit.errors import StoreError, plain

from .folder_files import read_bytes, read_json, write_json

FORMAT_VERSION: Final = 2  # of a folder with a plan

_log = logging.getLogger("studies")

_MANIFEST: Final = "manifest.json"
_LOCK: Final = ".lock"
_PART: Final = re.compile(r"part-(\d+)-[0-9a-f]{16}\.(json|npz)")  # .npz: of an earlier version, never read
_DIGITS: Final = 16
_MOST_NAMED: Final = 3  # differences in a message
_KEPT_THERE: Final = "finished parts are kept there: move it, or choose another output"


def write_part(folder: Path, name: str, content: bytes, suffix: str) -> Path:
    """Write a part; the same content under the same name is the same file."""
    path = folder / f"part-{name}-{_checksum(content)}.{suffix}"
    write_whole(path, content, StoreError)
    return path


def read_part(path: Path) -> bytes:
    """The content of a part, as it was written; raises `StoreError`."""
    content = read_bytes(path)
    if not path.stem.endswith(f"-{_checksum(content)}"):
        raise StoreError(path, "broken: its content is not what was written (the checksum in its name differs)")
    return content


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, as long as the block or the process lives; a killed process holds nothing."""
    try:
        fcntl = importlib.import_module("fcntl")
    except ImportError:  # Windows: the folder is not guarded there
        yield
        return
    try:
        stream = (folder / _LOCK).open("ab")
    except OSError as error:
        raise StoreError(folder, f"cannot be written: {error.strerror or error}") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(folder, "another run is writing into this folder", hint="wait for it, or end it") from None
        except OSError:
            pass  # a file system without locks, as some network ones: the folder is not guarded there
        yield


def remove_unfinished(folder: Path, name: str = "") -> None:
    """Remove what killed processes had not finished writing, of all files or of one; call it while no other writes."""
    # as `checked_files` names it, after the process
    pattern = re.compile(rf"\.{re.escape(name) or '.+'}\.\d+\.part")
    with contextlib.suppress(OSError):
        for path in list(folder.iterdir()):
            if pattern.fullmatch(path.name):
                path.unlink()


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any, Any]]:
    """What differs between two mappings: the key, and both values; None where one is not set."""
    for key in {**old, **new}:
        was, now = old.get(key), new.get(key)
        if isinstance(was, dict) and isinstance(now, dict):
            yield from differences(was, now, f"{prefix}{key}.")
        elif was != now:
            yield f"{prefix}{key}", was, now


def difference_texts(
    old: Mapping[str, Any], new: Mapping[str, Any], meanings: Mapping[str, str] | None = None
) -> list[str]:
    """One phrase for each difference; `meanings` has those of keys whose values say nothing to a reader."""
    texts = []
    for key, *values in differences(old, new):
        was, now = ("not set" if value is None else repr(value) for value in values)
        texts.append((meanings or {}).get(key) or f"{key}: {was} there, {now} now")
    return texts


class Parts:
    """Finished parts of one plan by number; in memory without a folder. Made by `planned_parts`, which holds it."""

    def __init__(self, folder: Path | None, classes: Mapping[str, type]) -> None:
        self._folder = folder
        self._classes = classes
        self._parts: dict[int, Any] = {}  # paths, or the parts themselves
        for file in sorted(folder.iterdir()) if folder is not None else ():
            if (match := _PART.fullmatch(file.name)) and match[2] == "json":
                # all are read once here, so that what is missing is known before anything is computed
                self._parts[number := int(match[1])] = file
                try:
                    self.read(number)
                except StoreError as error:
                    _log.warning("%s; this part is computed again", error)
                    _unlink(self._parts.pop(number))

    @property
    def finished(self) -> frozenset[int]:
        """Numbers of the parts that are there."""
        return frozenset(self._parts)

    def write(self, number: int, value: Any) -> None:
        """Store a part: dataclasses of the folder's classes, arrays, tuples and what JSON knows."""
        folder = self._folder
        self._parts[number] = value if folder is None else write_part(folder, f"{number:06d}", encoded(value), "json")

    def read(self, number: int) -> Any:
        """A part that is there."""
        if self._folder is None:
            return self._parts[number]
        content = read_part(self._parts[number])
        try:
            return decoded(content, self._classes)
        except Exception as error:  # any content may have a checksum
            raise StoreError(self._parts[number], f"broken: {error or type(error).__name__}") from None

    def remove(self) -> None:
        """Remove everything that this program wrote, and the folder if nothing else is in it."""
        self._parts.clear()
        if self._folder is not None:
            _clear(self._folder)
            _unlink(self._folder / _LOCK)
            with contextlib.suppress(OSError):
                self._folder.rmdir()


@contextlib.contextmanager
def planned_parts(
    path: Path | None,
    plan: Mapping[str, Any],
    classes: Mapping[str, type],
    *,
    replace: bool,
    meanings: Mapping[str, str] | None = None,
) -> Iterator[Parts]:
    """Hold a folder, made if need be, with the parts of the same plan that are in it; parts in memory without a path.

    Parts of another plan are removed, with a warning that says what differs, or refused without `replace`. A folder
    without a finished part is removed when the block ends in an error.
    """
    if path is None:
        yield Parts(None, classes)
        return
    try:
        path.mkdir(exist_ok=True)
    except FileExistsError:
        raise StoreError(path, "is not a folder", hint=_KEPT_THERE) from None
    except OSError as error:
        raise StoreError(path, f"cannot be made: {error.strerror or error}") from None
    with locked(path):
        try:
            remove_unfinished(path)
            _keep_only(path, {"format_version": FORMAT_VERSION, **json.loads(json.dumps(plan))}, replace, meanings)
            parts = Parts(path, classes)
        except OSError as error:  # the run that held it may have ended, and removed it, at this moment
            raise StoreError(path, f"cannot be used: {error.strerror or error}") from None
        try:
            yield parts
        except BaseException:
            if not parts.finished:
                parts.remove()
            raise


def _keep_only(path: Path, plan: dict[str, Any], replace: bool, meanings: Mapping[str, str] | None) -> None:
    """Leave nothing in the folder but parts of this plan, and the plan itself."""
    manifest = path / _MANIFEST
    if manifest.exists():
        try:
            texts = difference_texts(read_json(manifest), plan, meanings)
        except StoreError:
            if not replace:
                raise
            texts = ["its manifest is broken"]
        if not texts:
            return
        more = f"; and {len(texts) - _MOST_NAMED} more" if len(texts) > _MOST_NAMED else ""
        what = f"its parts are of another plan ({'; '.join(texts[:_MOST_NAMED])}{more})"
        if not replace:
            raise StoreError(path, what, hint="remove it, or choose another folder")
        if any(_PART.fullmatch(file.name) for file in path.iterdir()):
            _log.warning("%s: %s and are removed", path, what)
    else:
        others = [file.name for file in path.iterdir() if file.name != _LOCK and not _PART.fullmatch(file.name)]
        if others:
            raise StoreError(path, f"is not a folder of finished parts (it holds {min(others)})", hint=_KEPT_THERE)
    _clear(path)
    write_json(manifest, plan)


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
        raise StoreError(path, f"cannot be removed: {error.strerror or error}") from None


def encoded(value: Any) -> bytes:
    """Dataclasses, arrays and what JSON knows, as JSON; the same value gives the same bytes."""

    def form(item: Any) -> Any:
        if isinstance(item, np.ndarray):
            data = base64.b64encode(np.ascontiguousarray(item).tobytes()).decode()
            return {"dtype": item.dtype.str, "shape": item.shape, "data": data}
        if dataclasses.is_dataclass(item):
            fields = {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}
            return {"class": type(item).__name__, "fields": fields}
        return plain(item)

    return json.dumps(value, default=form, separators=(",", ":")).encode()


def decoded(content: bytes, classes: Mapping[str, type]) -> Any:
    """The value that `encoded` made the content of; lists come back as tuples."""

    def value_of(item: Any) -> Any:
        if isinstance(item, list):
            return tuple(map(value_of, item))
        if not isinstance(item, dict):
            return item
        if "dtype" in item:
            return np.frombuffer(base64.b64decode(item["data"]), item["dtype"]).reshape(item["shape"])
        return classes[item["class"]](**{name: value_of(part) for name, part in item["fields"].items()})

    return value_of(json.loads(content))
