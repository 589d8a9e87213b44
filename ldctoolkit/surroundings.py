"""What lies outside the program: other processes, temporary folders, memory, compiled caches."""

from __future__ import annotations

import contextlib
import functools
import importlib
import math
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

WORKERS: Final = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "POLARS_MAX_THREADS", "PYTHONSAFEPATH"), "1"
)
"""Environment of worker processes: they are what runs in parallel, and import nothing from the working directory."""


@contextlib.contextmanager
def safe_path() -> Iterator[None]:
    """Let no process that the block starts import modules from the working directory."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"  # as with `python -P`
    try:
        yield
    finally:
        os.environ.pop("PYTHONSAFEPATH", None)
        os.environ.update({} if before is None else {"PYTHONSAFEPATH": before})


def leave_with(parent: int) -> None:
    """End this process soon after its parent was killed: what it computes would be lost."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that is removed with the object, or by a later process of this machine where this one is killed."""
    sweep()
    return tempfile.TemporaryDirectory(prefix=f"ldc-{platform.node()}-{os.getpid()}-", ignore_cleanup_errors=True)


@functools.cache
def sweep() -> None:
    """Remove temporary folders of this user's processes that have ended; once."""
    name = re.compile(rf"ldc-(?:{re.escape(platform.node())}-)?(\d{{1,9}})-\w+")
    for path in Path(tempfile.gettempdir()).iterdir():
        match = name.fullmatch(path.name)
        with contextlib.suppress(OSError, AttributeError):  # another user's process, or a system without users
            if match and stat.S_ISDIR(path.lstat().st_mode) and path.lstat().st_uid == os.geteuid():
                try:
                    os.kill(int(match[1]), 0)
                except ProcessLookupError:
                    shutil.rmtree(path, ignore_errors=True)


def usable_cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not Linux
        return os.cpu_count() or 1


def machine() -> dict[str, Any]:
    """System, architecture, processor and cores, without names of hosts or users."""
    processor = platform.processor()
    with contextlib.suppress(OSError):  # not Linux
        match = re.search(r"^model name.*?: *(.*)", Path("/proc/cpuinfo").read_text(errors="replace"), re.MULTILINE)
        processor = match[1].strip() if match else processor
    system, architecture = f"{platform.system()} {platform.release()}", platform.machine()
    return {"system": system, "architecture": architecture, "processor": processor, "cores": os.cpu_count() or 1}


def free_memory() -> float:
    """Bytes of memory that are free; infinite where the system does not say."""
    free = math.inf
    with contextlib.suppress(OSError):
        match = re.search(r"MemAvailable: *(\d+)", Path("/proc/meminfo").read_text(encoding="ascii"))
        free = 1024.0 * int(match[1]) if match else free
    with contextlib.suppress(OSError, ValueError):  # in a container; "max" where there is no limit
        free = min(free, int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return free


def private(path: str | os.PathLike[str]) -> bool:
    """Whether a file or folder belongs to the user, and no other user can write to it or replace it."""
    if os.name != "posix":
        return True
    path = Path(path).resolve()
    if not path.exists() or path.stat().st_uid not in (0, os.geteuid()):
        return False

    def is_closed(folder: Path) -> bool:
        status = folder.stat()
        # a group with the number of a user is that user's alone
        writable = status.st_mode & (0o002 if status.st_gid == os.geteuid() != 0 else 0o022)
        # in a sticky folder only its owner replaces a file
        return not writable or (folder != path and bool(status.st_mode & stat.S_ISVTX))

    return all(map(is_closed, (path, *path.parents)))


def cache_folder() -> Path:
    """The folder that the platform has for caches of the user, for compiled code."""
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "ldctoolkit"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ldctoolkit"


@functools.cache
def guard_caches() -> None:
    """Let Numba use caches only where folder and file are `private`, and no settings from the working directory."""
    caching: Any = importlib.import_module("numba.core.caching")
    config: Any = importlib.import_module("numba.core.config")
    config._config_fname = os.devnull
    config.reload_config()
    locate = caching._CacheLocator.ensure_cache_path

    def ensure_cache_path(locator: Any) -> None:
        locate(locator)
        last = isinstance(locator, caching.UserWideCacheLocator)  # there must be one, and files are looked at, too
        if not (last or private(locator.get_cache_path())):
            raise PermissionError(locator.get_cache_path())

    class _File(caching.IndexDataCacheFile):  # type: ignore[misc]
        def _load_index(self) -> Any:
            return super()._load_index() if private(self._index_path) else {}

        def _load_data(self, name: str) -> Any:
            if not private(self._data_path(name)):
                raise PermissionError(name)  # as if it were not there
            return super()._load_data(name)

    caching._CacheLocator.ensure_cache_path = ensure_cache_path
    caching.IndexDataCacheFile = _File
