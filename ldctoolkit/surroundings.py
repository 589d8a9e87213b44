"""What may be used that lies outside the program: modules for other processes, temporary folders, compiled caches."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import math
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

SAFE_PATH: Final = {"PYTHONSAFEPATH": "1"}
"""Environment of a Python process that imports nothing from the working directory, as with ``python -P``."""


@contextlib.contextmanager
def safe_path() -> Iterator[None]:
    """Let no process that the block starts import modules from the working directory."""
    before = {name: os.environ.get(name) for name in SAFE_PATH}
    os.environ.update(SAFE_PATH)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)


# ------------------------------------------------------------------------------------------------ temporary folders


@functools.cache
def _machine() -> str:
    """Stands for the machine and its process numbers: others may use the same folder for temporary files."""
    numbers = Path("/proc/self/ns/pid")
    name = f"{platform.node()} {numbers.readlink() if numbers.is_symlink() else ''}"
    return hashlib.sha256(name.encode()).hexdigest()[:8]


def temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that is removed with the object, or by a later process where this one is killed."""
    sweep()
    return tempfile.TemporaryDirectory(prefix=f"ldc-{_machine()}-{os.getpid()}-", ignore_cleanup_errors=True)


@functools.cache
def sweep() -> None:
    """Remove temporary folders of this user's processes that have ended; once."""
    if os.name != "posix":
        return
    name = re.compile(rf"ldc-(?:{_machine()}-)?(\d{{1,9}})-\w+")
    with contextlib.suppress(OSError), os.scandir(tempfile.gettempdir()) as entries:
        for entry in entries:
            found = name.fullmatch(entry.name)
            if found and entry.is_dir(follow_symlinks=False) and entry.stat().st_uid == os.geteuid():
                try:
                    os.kill(int(found[1]), 0)
                except ProcessLookupError:
                    shutil.rmtree(entry.path, ignore_errors=True)
                except OSError:
                    pass  # it is another user's process


def free_memory() -> float:
    """Bytes of memory that are free; infinite where the system does not say."""
    free = math.inf
    with contextlib.suppress(OSError):
        found = re.search(r"MemAvailable: *(\d+)", Path("/proc/meminfo").read_text(encoding="ascii"))
        free = 1024.0 * int(found[1]) if found else free
    with contextlib.suppress(OSError, ValueError):  # in a container; "max" where there is no limit
        used, most = (int(Path("/sys/fs/cgroup", f"memory.{name}").read_text()) for name in ("current", "max"))
        free = min(free, most - used)
    return free


# ------------------------------------------------------------------------------------------------ compiled caches


def private(path: str | os.PathLike[str]) -> bool:
    """Whether a file or folder belongs to the user, and nobody else can write to it or put another in its place."""
    if os.name != "posix":
        return True
    place = Path(path).resolve()
    if not place.exists():
        return False
    for one in (place, *place.parents):
        found = one.stat()
        loose = found.st_mode & (stat.S_IWOTH if _alone_in(found.st_gid) else stat.S_IWOTH | stat.S_IWGRP)
        kept = one != place and found.st_mode & stat.S_ISVTX  # nobody can replace what belongs to another there
        if found.st_uid not in (0, os.geteuid()) or (loose and not kept):
            return False
    return True


@functools.cache
def _alone_in(group: int) -> bool:
    """Whether the user is the only member of a group."""
    import grp
    import pwd

    try:
        user, found = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return found.gr_name == user and set(found.gr_mem) <= {user}


def cache_folder() -> Path:
    """The folder that the platform has for caches of the user, for compiled code."""
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "ldctoolkit"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ldctoolkit"


def guard(caching: Any) -> None:
    """Let Numba use a cache only where folder and file are `private`, and no settings from the working directory."""
    config: Any = sys.modules["numba.core.config"]
    config._config_fname = os.devnull
    config.reload_config()
    locate = caching._CacheLocator.ensure_cache_path

    def ensure_cache_path(locator: Any) -> None:
        locate(locator)
        if not private(locator.get_cache_path()):
            raise PermissionError(locator.get_cache_path())

    class _File(caching.IndexDataCacheFile):  # type: ignore[misc]
        def _load_index(self) -> Any:
            return super()._load_index() if private(self._index_path) else {}

        def _load_data(self, name: str) -> Any:
            if not private(self._data_path(name)):
                raise PermissionError(name)  # as if it were not there
            return super()._load_data(name)

    class _Last(caching.InTreeCacheLocator):  # type: ignore[misc]
        def get_cache_path(self) -> str:
            return _last_folder().name

    caching._CacheLocator.ensure_cache_path = ensure_cache_path
    caching.IndexDataCacheFile = _File
    caching.CacheImpl._locator_classes = [*caching.CacheImpl._locator_classes, _Last]


@functools.cache
def _last_folder() -> tempfile.TemporaryDirectory[str]:
    what = "others can write to every folder that compiled functions could be kept in; NUMBA_CACHE_DIR may name one"
    warnings.warn(f"{what}: they are compiled anew", stacklevel=2)
    return temporary_folder()
