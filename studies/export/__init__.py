"""The way from a design to an ECU: C code that was run in the loop that ranked it."""

from __future__ import annotations

import dataclasses
import io
import platform
import uuid
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ldctoolkit.checked_files import write_whole
from ldctoolkit.control import Controller
from ldctoolkit.controllers import external
from ldctoolkit.errors import InputError, StoreError, expect
from ldctoolkit.scenario_model.model import load_model
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.surroundings import temporary_folder

from .c_code import HEADER, SOURCE, Code, Origin, changed_files, is_stale, parameters, render, sources_of, write_folder
from .loop_check import Check, check, record, vectors

__all__ = ["Check", "Code", "Export", "Origin", "changed_files", "export_c", "is_stale", "parameters"]

DEPARTURES = 1000  # a check drives at least so many scenarios, where there are so many


@dataclasses.dataclass(frozen=True)
class Export:
    """What an export wrote, and how its code compares with the toolkit's law."""

    files: tuple[Path, ...]
    check: Check | None  # None where it was not run
    not_run: str = ""  # Why


def export_c(
    controller: Controller,
    setup: Setup,
    y_s: float,
    folder: str | Path,
    *,
    scenarios: Scenarios | None = None,
    origin: Origin | None = None,
    run_check: bool = True,
    fmu: bool = False,
) -> Export:
    """Write a design as C99 code with a test bench, and drive that code in the closed loop.

    Raises `InputError` for a law that has no C code, and for a folder whose files were changed by
    hand; `LdcError` if the compiler refuses the code.

    Parameters
    ----------
    controller : Controller
        The design.
    setup : Setup
        What it is designed for and driven with.
    y_s : float [m]
        Trigger threshold.
    folder : path
        Where the files go; it is made.
    scenarios : Scenarios, optional
        Departures of the check and the test vectors; by default 1,000 of the bundled model ``"reference"``.
    origin : Origin, optional
        The study and its verdict, for the header.
    run_check : bool
        Compile the code and compare it with the toolkit's law: commands on the same inputs, S in the loop.
    fmu : bool
        Pack the code as an FMU too.

    Returns
    -------
    Export
        ``check`` is None without a compiler.

    Examples
    --------
    >>> import tempfile
    >>> from ldctoolkit import LQR
    >>> few = load_model("reference").sample(20, 20, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     export = export_c(LQR(), Setup(), 0.2, folder, scenarios=few, run_check=False)
    ...     [path.name for path in export.files]
    ['ldc_controller.h', 'ldc_controller.c', 'main.c', 'README.md', 'test_vectors.csv']
    """
    expect("setup", setup, Setup)
    expect("scenarios", scenarios, Scenarios | None)
    if not isinstance(folder, str | Path) or not str(folder):
        raise InputError("folder", value=folder, allowed="a path")
    code = Code.of(controller, setup, y_s, origin)
    if scenarios is None:
        scenarios = load_model("reference").sample(DEPARTURES // 2, DEPARTURES // 2, seed=setup.seed)
    recording = record(code, scenarios)
    if not recording.counts.any():
        problem = f"no departure beyond y_s = {y_s:g} m that can be compared"
        raise InputError("scenarios", problem, allowed="one or more")
    folder, command = Path(folder), external.compiler()
    texts = write_folder(code, folder, vectors(recording))
    files = tuple(folder / name for name in texts) + ((_write_fmu(code, texts, folder, command),) if fmu else ())
    if not run_check:
        return Export(files, None, "not wanted")
    if command is None:
        return Export(files, None, "no C compiler: neither cc on the path nor the package ziglang")
    return Export(files, check(recording, command))


_PLATFORMS: Final = {"Linux": ("linux64", ".so"), "Darwin": ("darwin64", ".dylib"), "Windows": ("win64", ".dll")}


def _write_fmu(code: Code, texts: dict[str, str], folder: Path, command: Sequence[str] | None) -> Path:
    """An FMU of FMI 2.0; without a compiler there is no binary, and the importer compiles the sources."""
    sizes = [(name, size) for name, size, kind in code.inputs if kind == "ldc_real"]
    sources = sources_of(texts)
    values = {
        "sources": sources, "driver": code.driver,
        "guid": f"{{{uuid.uuid5(uuid.NAMESPACE_OID, texts[SOURCE] + texts[HEADER])}}}",
        "reals": [f"{name}[{i + 1}]" if size else name for name, size in sizes for i in range(max(size, 1))],
        "whole": [name for name, _, kind in code.inputs if kind == "int32_t"], "fields": code.inputs,
        "dt": repr(code.setup.dt), "id": code.design.id, "title": code.label, "version": code.version,
    }  # fmt: skip
    files = {
        "modelDescription.xml": render("modelDescription.xml", **values).encode(),
        "sources/fmu.c": render("fmu.c", **values).encode(),
        **{f"sources/{name}": texts[name].encode() for name in (HEADER, *sources)},
        "documentation/README.md": texts["README.md"].encode(),
    }
    if command is not None:
        if platform.system() not in _PLATFORMS:
            raise InputError("--fmu", "no binary for this system", value=platform.system(), allowed=_PLATFORMS)
        system, suffix = _PLATFORMS[platform.system()]
        library = f"ldc_controller{suffix}"
        with temporary_folder() as room:
            for name in ("fmu.c", *sources, HEADER):
                write_whole(Path(room) / name, files[f"sources/{name}"], StoreError)
            options = ("-std=c99", "-O2", "-fPIC", "-shared")
            external.compile_c(command, Path(room), *options, "fmu.c", *sources, "-o", library, "-lm")
            files[f"binaries/{system}/{library}"] = (Path(room) / library).read_bytes()
    path = folder / "ldc_controller.fmu"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in files.items():
            packed.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)  # no date: the same bits each time
    write_whole(path, stream.getvalue(), StoreError)
    return path
