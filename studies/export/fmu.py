"""The exported C code as an FMU of FMI 2.0 for co-simulation: sources, and a binary for this platform."""

from __future__ import annotations

import platform
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from ldctoolkit.errors import InputError
from studies.export.c_code import FMU, HEADER, SOURCE, Code, digest, render
from studies.export.loop_check import compile_c
from studies.storage.files import stored_file

_PLATFORMS: Final = {"Linux": ("linux64", ".so"), "Darwin": ("darwin64", ".dylib"), "Windows": ("win64", ".dll")}


def write_fmu(code: Code, texts: dict[str, str], folder: Path, command: Sequence[str] | None) -> Path:
    """Pack the C code of a folder; without a compiler there is no binary, and the importer compiles the sources."""
    values = _values(code, texts)
    files = {
        "modelDescription.xml": render("modelDescription.xml", **values).encode(),
        "sources/fmu.c": render("fmu.c", **values).encode(),
        **{f"sources/{name}": texts[name].encode() for name in (HEADER, SOURCE)},
        "documentation/README.md": texts["README.md"].encode(),
    }
    if command is not None:
        system, suffix = _platform()
        library, options = f"ldc_controller{suffix}", ("-std=c99", "-O2", "-fPIC", "-shared")
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as room:
            for name in ("fmu.c", SOURCE, HEADER):
                (Path(room) / name).write_bytes(files[f"sources/{name}"])
            compile_c(command, Path(room), *options, "fmu.c", SOURCE, "-o", library, "-lm")
            files[f"binaries/{system}/{library}"] = (Path(room) / library).read_bytes()
    path = folder / FMU
    with stored_file(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in files.items():
            packed.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)  # no date: the same bits each time
    return path


def _platform() -> tuple[str, str]:
    system = platform.system()
    if system not in _PLATFORMS:
        raise InputError(f"--fmu: no name for a binary of {system}; allowed on {', '.join(_PLATFORMS)}")
    return _PLATFORMS[system]


def _values(code: Code, texts: dict[str, str]) -> dict[str, Any]:
    of_code = digest(texts[SOURCE] + texts[HEADER])
    variables: list[dict[str, Any]] = []

    def add(name: str, kind: str, reference: int, causality: str, start: str | None) -> None:
        variables.append({
            "name": name, "type": kind, "reference": reference, "causality": causality, "start": start,
            "variability": "continuous" if kind == "Real" and causality == "input" else "discrete",
            "initial": "calculated" if causality == "output" else "", "index": len(variables) + 1,
        })  # fmt: skip

    sizes = {name: size for name, size, kind in code.inputs if kind == "ldc_real"}
    reals = [f"{name}[{i + 1}]" if size else name for name, size in sizes.items() for i in range(max(size, 1))]
    whole = [name for name, _, kind in code.inputs if kind == "int32_t"]
    for i, name in enumerate(reals):
        add(name, "Real", i, "input", "20.0" if name == "v" else "0.0")
    for i, name in enumerate(whole):
        add(name, "Integer", i, "input", "0")
    add("delta", "Real", len(reals), "output", None)
    for i, name in enumerate(("phase", "side", "status", "iterations")):
        add(name, "Integer", len(whole) + i, "output", None)
    guid = f"{{{of_code[:8]}-{of_code[8:12]}-{of_code[12:16]}-{of_code[16:20]}-{of_code[20:32]}}}"
    return {
        "guid": guid, "variables": variables, "fields": code.inputs, "dt": repr(code.setup.dt), "id": code.design.id,
        "title": code.label, "version": code.version,
    }  # fmt: skip
