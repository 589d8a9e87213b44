"""Controllers from outside of the toolkit: an FMU, or C code with the interface of ``ldc export``.

Every departure is presented as a departure to the left, in ISO 8855 signs, and each scenario has its instance. Each
file makes a class that is identified by the content of the file, not by its path.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.checked_files import write_whole
from ldctoolkit.control import Controller, EventStatus, Preview, SteeringLaw
from ldctoolkit.errors import InputError, LdcError, UnknownNameError, expect, first_line
from ldctoolkit.surroundings import temporary_folder
from ldctoolkit.vehicle import Plant

STATE: Final = ("e_y", "e_y_rate", "e_psi", "e_psi_rate")
_LANE: Final = ("curvature", "yaw_rate", "heading")  # also ahead, as ``curvature@0.5``
_OTHERS: Final = (
    "v", "wheel", "delta_prev", "line_left", "line_right", "line_rate", "takeover", "engage", "t",
    "frame_e_y", "frame_e_psi", "frame_new", "curvature_seen",
)  # fmt: skip
_BEYOND: Final = 100.0  # [m] At the takeover: further beyond the line than any threshold
_FAILED, _BEYOND_DELTA_MAX = 1 | 2 | 4 | 16, 8  # Bits of ``status``, as in the header of an export


@dataclasses.dataclass(frozen=True)
class FileContent:
    """A file, identified by its content; `held`, as its path, is not a field and does not change the identity."""

    digest: str
    held: dataclasses.InitVar[Any]

    def __post_init__(self, held: Any) -> None:
        object.__setattr__(self, "_held", held)

    def __call__(self) -> Any:
        """The path of the file, or what was compiled from it."""
        return vars(self)["_held"]


def content_digest(*contents: bytes) -> str:
    """A hash of files."""
    return hashlib.sha256(b"".join(hashlib.sha256(content).digest() for content in contents)).hexdigest()


def read_file(path: str | Path) -> bytes:
    """The content of a file."""
    expect("path", path, str | Path)
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None


# ------------------------------------------------------------------------------------------------ the law


def signal_of(name: Any, path: str) -> tuple[str, float]:
    """A signal and its lookahead time [s]."""
    base, ahead, time = str(name).partition("@")
    if base not in (*STATE, *_LANE, *_OTHERS):
        raise UnknownNameError(path, "is not a signal", value=name, allowed=(*STATE, *_LANE, *_OTHERS))
    try:
        if ahead and (base not in _LANE or not -10.0 <= float(time) < np.inf):
            raise ValueError
    except ValueError:
        allowed = f"{', '.join(_LANE)}, each with a lookahead time [s], as 'curvature@0.5'"
        raise InputError(path, value=name, allowed=allowed) from None
    return base, float(time or 0.0)


def exported_signals(names: Iterable[str], header: str, path: str) -> Iterator[tuple[str, str]]:
    """Signals of inputs that have the names of the interface of ``ldc export``."""
    stated = re.search(r"#define LDC_LOOKAHEAD (.*)", header)
    times = stated[1].split() if stated else []
    for name in names:
        base, _, place = name.removesuffix("]").partition("[")
        if place and not (place.isdecimal() and 1 <= int(place) <= len(times)):
            hint = "write '#define LDC_LOOKAHEAD 0.0 0.5' [s] into the header"
            raise InputError(f"{path}: {name}", "has no lookahead time", hint=hint)
        # its trigger is that of the toolkit
        yield "takeover" if base == "line_left" else f"{base}@{times[int(place) - 1]}" if place else base, name


@dataclasses.dataclass(frozen=True)
class ExternalController(Controller):
    """Base of the classes that `FmuLaw` and `CLaw` make."""

    law: ClassVar[type[ExternalLaw]]
    file: ClassVar[FileContent]
    inputs: ClassVar[tuple[tuple[str, str], ...]]  # Signals, and the names of the inputs that are shown them
    outputs: ClassVar[tuple[str, ...]] = ()  # Of an FMU
    settings: ClassVar[tuple[str, ...]] = ()  # Parameters of an FMU, in the order of the gains
    communication_step: ClassVar[float | None] = None
    batch: ClassVar[int] = 50

    def prepare(self, plant: Plant) -> ExternalLaw:
        """Check the step; instances are made at their first use."""
        step = self.communication_step or plant.dt
        parts = round(plant.dt / step)
        if parts < 1 or abs(parts * step - plant.dt) > 1e-9 * plant.dt:
            allowed = f"the sample time of the loop, {plant.dt:g} s, or a whole fraction of it"
            raise InputError(f"{self.name}.step", value=step, allowed=allowed)
        return self.law(self, plant, parts, np.arange(plant.n))


def design_of(base: dict[str, Any], path: Path, kind: str, name: str, gains: Iterable[Any] = ()) -> Controller:
    """A design of a new class for one file."""
    name = name or re.sub(r"\W+", "_", path.stem).strip("_")
    if not isinstance(name, str) or not re.fullmatch(r"\w+", name):
        raise InputError("name", value=name, allowed="letters, digits and '_'")
    title = f"{name.replace('_', ' ').capitalize()} ({kind})"
    # not importable: the class is pickled by value and identified by its content
    names = {"name": name, "title": title, "__doc__": f"{title}.", **base}
    made = dataclasses.make_dataclass(name, gains, bases=(ExternalController,), namespace=names, frozen=True)
    made.__module__ = "external_controllers"  # from 3.12 on it would be that of the caller
    return made()  # type: ignore[no-any-return]


@dataclasses.dataclass(frozen=True)
class ExternalLaw(SteeringLaw):
    """An external controller of n scenarios; a state is empty before the first step."""

    design: ExternalController
    plant: Plant
    parts: int  # Communication steps of a sample
    rows: IntArray  # (n,) Scenarios of the plant, and instances

    @functools.cached_property
    def _signals(self) -> list[tuple[str, float]]:
        signals = [signal_of(name, "") for name, _ in self.design.inputs]
        return [("curvature", -self.plant.age) if base == "curvature_seen" else (base, time) for base, time in signals]

    @functools.cached_property
    def preview_times(self) -> FloatArray:
        """Those of the signals of the lane."""
        return np.unique([time for base, time in self._signals if base in _LANE])

    def init(self, n: int) -> Any:
        """Nothing yet."""
        return ()

    def _commands(self, shown: FloatArray, state: Any) -> tuple[FloatArray, npt.NDArray[Any], Any]:
        """Commands, status bits and the next state for inputs (n, i)."""
        raise NotImplementedError

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: Any
    ) -> tuple[FloatArray, Any, Any]:
        """Commands for the signals at this sample."""
        v, edge = self.plant.v[self.rows], self.plant.model.parameters.edge_offset
        line, wheel, frame = x[:, 0] - edge, preview.wheel, preview.frame
        if frame is None or not len(state):  # a filter in the controller starts from the state
            frame = x[:, (0, 2)]
        now = dict(zip(STATE, x.T, strict=True)) | {
            "v": v, "wheel": delta_prev if wheel is None else wheel, "delta_prev": delta_prev, "t": t,
            "line_left": line, "line_right": -x[:, 0] - edge, "line_rate": x[:, 1], "engage": np.ones(t.size),
            "takeover": line if len(state) else np.full(t.size, _BEYOND), "frame_new": np.isfinite(frame[:, 0]),
            "frame_e_y": np.nan_to_num(frame[:, 0]), "frame_e_psi": np.nan_to_num(frame[:, 1]),
        }  # fmt: skip
        shown = np.empty((t.size, len(self._signals)))
        for i, (base, time) in enumerate(self._signals):
            if base in _LANE:
                j = int(np.searchsorted(self.preview_times, time))
                ahead = preview.heading[:, j] if base == "heading" else preview.yaw_rate[:, j]
                shown[:, i] = ahead / v if base == "curvature" else ahead
            else:
                shown[:, i] = now[base]
        delta, bits, after = self._commands(shown, state)
        failed = ((bits & _FAILED) != 0) | ~np.isfinite(delta)
        beyond = np.where(bits & _BEYOND_DELTA_MAX, EventStatus.BEYOND_DELTA_MAX, EventStatus.OK)
        return delta, after, np.where(failed, EventStatus.SOLVER_FAILED, beyond).astype(np.int8)

    def _of(self, rows: IntArray) -> Any:
        return dataclasses.replace(self, rows=self.rows[rows])


# ------------------------------------------------------------------------------------------------ C code

HEADER: Final = "ldc_controller.h"


def compiler() -> list[str] | None:
    """The command of a C compiler; None without one."""
    if shutil.which("cc"):
        return ["cc"]
    return [sys.executable, "-P", "-m", "ziglang", "cc"] if importlib.util.find_spec("ziglang") else None


def compile_c(command: Sequence[str], folder: Path, *arguments: str, text: str = "") -> str:
    """Run the compiler in a folder, with `text` as standard input; raises `LdcError` with its first error."""
    done = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, text=True, check=False, input=text)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise LdcError(" ".join(command), next((line for line in lines if "error" in line), lines[0]))
    return done.stdout


class _Library:
    """A C controller, loaded."""

    def __init__(self, file: FileContent) -> None:
        import cffi

        (header, declarations, binary), self.ffi, self.room = file(), cffi.FFI(), temporary_folder()
        path = Path(self.room.name) / "controller.so"
        write_whole(path, binary, LdcError)
        try:
            self.ffi.cdef(declarations)
            library = self.ffi.dlopen(str(path))
            self.step, self.init = library.ldc_step, getattr(library, "ldc_init", None)
            self.inputs, self.outputs = self._struct("ldc_inputs"), self._struct("ldc_outputs")
            self.size = self.ffi.sizeof("ldc_state")
        except Exception as error:  # of cffi, of its parser, of the linker
            allowed = "ldc_inputs, ldc_outputs, ldc_state and ldc_step as ldc export writes them"
            raise InputError(header, first_line(error), allowed=allowed) from None

    def _struct(self, name: str) -> np.dtype[np.void]:
        """A struct of C as NumPy sees it."""
        names, formats, offsets = [], [], []
        for key, field in self.ffi.typeof(name).fields:
            array = field.type.kind == "array"
            item, shape = (field.type.item, (field.type.length,)) if array else (field.type, ())
            letter = "f" if item.cname in ("float", "double") else "u" if item.cname.startswith("u") else "i"
            formats.append((f"{letter}{self.ffi.sizeof(item)}", shape))
            names.append(key)
            offsets.append(field.offset)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.ffi.sizeof(name)})

    def call(self, function: Any, **structs: npt.NDArray[Any]) -> None:
        """Call a function with the i-th struct of each array, for all i."""
        cast, buffer = self.ffi.cast, self.ffi.from_buffer
        pointers = [cast(f"ldc_{kind} *", buffer(array)) for kind, array in structs.items()]
        for i in range(len(structs["state"])):
            function(*(pointer + i for pointer in pointers))


_library = functools.lru_cache(maxsize=32)(_Library)


@dataclasses.dataclass(frozen=True)
class _CSteering(ExternalLaw):
    """Its state is that of the instances, as bytes."""

    def _commands(self, shown: FloatArray, state: Any) -> tuple[FloatArray, npt.NDArray[Any], Any]:
        library, n = _library(self.design.file), shown.shape[0]
        after = state.copy() if len(state) else np.zeros((n, library.size), dtype=np.uint8)
        if not len(state) and library.init is not None:
            library.call(library.init, state=after)
        rows, out = np.zeros(n, dtype=library.inputs), np.zeros(n, dtype=library.outputs)
        columns = iter(shown.T)
        for name in library.inputs.names or ():
            for place in np.ndindex(rows[name].shape[1:]):
                rows[name][(slice(None), *place)] = next(columns)
        library.call(library.step, inputs=rows, state=after, outputs=out)
        bits = out["status"] if "status" in (library.outputs.names or ()) else np.zeros(n, dtype=np.int64)
        return out["delta"].astype(np.float64), bits, after

    def take(self, rows: IntArray, state: Any) -> tuple[SteeringLaw, Any]:
        return self._of(rows), state[rows] if len(state) else state


def CLaw(path: str | Path, *, name: str = "") -> Controller:
    """Make a design of a controller in C with the interface of ``ldc export``.

    The header ``ldc_controller.h`` beside it declares ``ldc_inputs``, ``ldc_outputs``, ``ldc_state``, ``ldc_step`` and,
    if there is one, ``ldc_init``. The state is plain data; the code keeps nothing else. Raises `InputError` for a file
    that cannot be used, `UnknownNameError` for an input that is no signal, `LdcError` for what the compiler refuses.

    Parameters
    ----------
    path : path
        The folder of an export, a C source, or a shared library. The content of sources, headers and library is a part
        of the design's identity.
    name : str
        Name of the law; by default that of the file or folder.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.CLaw("missing/controller.c")
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: missing/controller.c: cannot be read: No such file or directory
    """
    expect("path", path, str | Path)
    path, command = Path(path), compiler()
    folder = path if path.is_dir() else path.parent
    files = sorted(file for file in folder.glob("*.c") if file.name != "main.c") if path.is_dir() else [path]
    if not files or files[0].suffix not in (".c", ".so", ".dylib", ".dll"):
        raise InputError(path, "is not C code", allowed="a folder that ldc export wrote, a C source or a library")
    contents, header = [read_file(file) for file in files], read_file(folder / HEADER)
    if command is None:
        raise LdcError("cc", "is not installed, and C code needs it", hint='pip install "ldctoolkit[export]"')
    # what the header includes is of no interest to the interface
    text = re.sub(r"(?m)^[ \t]*#[ \t]*include.*$", "", header.decode(errors="replace"))
    binary, declarations = contents[0], compile_c(command, folder, "-E", "-P", "-x", "c", "-", text=text)
    if files[0].suffix == ".c":
        with temporary_folder() as room:
            options = ("-std=c99", "-O2", "-fPIC", "-shared", *(file.name for file in files))
            compile_c(command, folder, *options, "-o", f"{room}/controller.so", "-lm")
            binary = read_file(Path(room) / "controller.so")
    headers = map(read_file, sorted(folder.glob("*.h")))
    held = FileContent(content_digest(*contents, *headers), (folder / HEADER, declarations, binary))
    struct = _library(held).inputs
    named = [(key, place) for key in struct.names or () for place in np.ndindex(struct[key].shape)]
    inputs = tuple(exported_signals((key + "".join(f"[{j + 1}]" for j in place) for key, place in named), text, HEADER))
    for signal, _ in inputs:
        signal_of(signal, f"{folder / HEADER}: ldc_inputs")
    return design_of({"law": _CSteering, "file": held, "inputs": inputs}, path.absolute(), "C", name)
