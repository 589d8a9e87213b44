"""Controllers from outside of the toolkit: an FMU, or C code with the interface of ``ldc export``.

Both are shown every departure as one to the left, positive to the left (ISO 8855), and hold one instance a scenario.
Each file makes a class of its own, which is known by the file's content: where the file lies decides no number.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import hashlib
import importlib.util
import io
import keyword
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.checked_files import read_regular, write_whole
from ldctoolkit.control import Controller, EventStatus, Preview, StatusArray, SteeringLaw
from ldctoolkit.declared import checked_number, gain
from ldctoolkit.errors import InputError, LdcError, UnknownNameError, first_line
from ldctoolkit.surroundings import temporary_folder
from ldctoolkit.vehicle.bicycle import Plant

_STATE: Final = ("e_y", "e_y_rate", "e_psi", "e_psi_rate")
_LANE: Final = ("curvature", "yaw_rate", "heading")  # also ahead, as ``curvature@0.5``
_LINES: Final = ("line_left", "line_right", "line_rate", "takeover")
SIGNALS: Final = ("t", *_STATE, "v", "wheel", "delta_prev", *_LANE, *_LINES, "engage")
"""What an external controller can be shown; `docs/how-to/my-fmu.md` says what each is."""

_BEYOND: Final = 100.0  # [m] At the takeover: further beyond the line than any threshold
_FAILED, _BEYOND_DELTA_MAX = 1 | 2 | 4 | 16, 8  # bits of ``status``, as in the header of an export


@dataclasses.dataclass(frozen=True)
class FileContent:
    """A file by its content. What this program has of it, as its path, is no field: it decides no identity."""

    digest: str
    held: dataclasses.InitVar[Any]

    def __post_init__(self, held: Any) -> None:
        object.__setattr__(self, "_held", held)

    def __call__(self) -> Any:
        """What this program has of the file."""
        return vars(self)["_held"]


def _read(path: Path) -> bytes:
    return read_regular(path, InputError, None)


def _digest(*contents: bytes) -> str:
    return hashlib.sha256(b"".join(hashlib.sha256(content).digest() for content in contents)).hexdigest()


# ------------------------------------------------------------------------------------------------ signals


def _signal(name: str, path: str) -> tuple[str, float]:
    """A signal and its lookahead time [s]."""
    base, ahead, time = name.partition("@") if isinstance(name, str) else (name, "", "")
    if base not in SIGNALS or (ahead and base not in _LANE):
        raise UnknownNameError(path, "is no signal", value=name, allowed=SIGNALS, hint="ahead: 'curvature@0.5' [s]")
    try:
        return base, checked_number("", float(time), lower=-10.0) if ahead else 0.0
    except ValueError:
        raise InputError(path, value=name, allowed=f"a lookahead time [s], as in '{base}@0.5'") from None


def _export_signals(names: Iterable[str], header: str, path: str) -> dict[str, str]:
    """Signals by the names that they have in the interface of ``ldc export``."""
    stated = re.search(r"#define LDC_LOOKAHEAD (.*)", header)
    times, signals = stated[1].split() if stated else [], {}
    for name in names:
        base, _, place = name.removesuffix("]").partition("[")
        if place and not (place.isdecimal() and 1 <= int(place) <= len(times)):
            raise InputError(
                f"{path}: {name}", "has no lookahead time", hint="#define LDC_LOOKAHEAD 0.0 0.5 in the header"
            )
        # its trigger is the toolkit's: the takeover
        signals[name] = "takeover" if base == "line_left" else f"{base}@{times[int(place) - 1]}" if place else base
    return signals


@dataclasses.dataclass(frozen=True)
class ExternalLaw(SteeringLaw):
    """What an external controller of n scenarios is shown, in the order of its inputs."""

    signals: tuple[tuple[str, float], ...]
    v: FloatArray  # (n,) [m/s]
    edge: float  # [m] Offset of the vehicle's centre when its edge is on the line
    dt: float

    @property
    def preview_times(self) -> FloatArray:
        """Of the signals of the lane."""
        return np.unique([time for base, time in self.signals if base in _LANE])

    def shown(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, *, first: bool
    ) -> FloatArray:
        """Values (n, i) of the inputs."""
        line, wheel, times = x[:, 0] - self.edge, preview.wheel, self.preview_times
        now = dict(zip(_STATE, x.T, strict=True)) | {
            "t": t, "v": self.v, "delta_prev": delta_prev, "wheel": delta_prev if wheel is None else wheel,
            "line_left": line, "line_right": -x[:, 0] - self.edge, "line_rate": x[:, 1], "engage": np.ones(t.size),
            "takeover": np.full(t.size, _BEYOND) if first else line,
        }  # fmt: skip
        columns = np.empty((t.size, len(self.signals)))
        for i, (base, time) in enumerate(self.signals):
            if base in _LANE:
                j = int(np.searchsorted(times, time))
                ahead = preview.heading[:, j] if base == "heading" else preview.yaw_rate[:, j]
                columns[:, i] = ahead / self.v if base == "curvature" else ahead
            else:
                columns[:, i] = now[base]
        return columns


def _status(bits: npt.NDArray[Any], delta: FloatArray) -> StatusArray:
    """Of commands, from bits as in the header of an export; a command that is no number has failed."""
    failed = ((bits & _FAILED) != 0) | ~np.isfinite(delta)
    beyond = np.where(bits & _BEYOND_DELTA_MAX, EventStatus.BEYOND_DELTA_MAX, EventStatus.OK)
    return np.where(failed, EventStatus.SOLVER_FAILED, beyond).astype(np.int8)


def _design(
    base: type[Controller], path: Path, kind: str, name: str, gains: Sequence[Any] = (), **held: Any
) -> Controller:
    """A design of a new class for one file."""
    name = name or re.sub(r"\W+", "_", path.stem).strip("_")
    title = f"{name.replace('_', ' ').capitalize()} ({kind})"
    # by no module's name: it is sent by value, and known by what it holds
    names = {"name": name, "title": title, "__doc__": f"{title}.", "__module__": "external_controllers", **held}
    design: Controller = dataclasses.make_dataclass(name, gains, bases=(base,), namespace=names, frozen=True)()
    return design


# ------------------------------------------------------------------------------------------------ FMU


def _fmpy() -> Any:
    try:
        import fmpy
        import fmpy.fmi2
        import fmpy.fmi3
    except ImportError:
        raise LdcError("fmpy", "is not installed, and FMUs need it", hint="pip install 'ldctoolkit[fmu]'") from None
    return fmpy


_REALS: Final = ("Real", "Float64", "Float32")
_WHOLE: Final = ("Integer", "Enumeration", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
_PYTHON: Final = {"Boolean": bool} | dict.fromkeys(_REALS, float)  # int for the others

Calls = list[tuple[str, list[int], list[int]]]  # type, value references, places among the values


class Fmu:
    """An FMU as a thread of this process has it: its description and its instances."""

    def __init__(self, content: bytes, path: Path) -> None:
        fmpy = _fmpy()
        self.path, self.content, self.instances = path, content, list[Instance]()
        allowed = "an FMU of FMI 2.0 or 3.0 for co-simulation"
        try:
            self.description = fmpy.read_model_description(io.BytesIO(content), validate=False)
            platforms = [name for name in fmpy.supported_platforms(io.BytesIO(content)) if name != "c-code"]
        except Exception as error:  # whatever its readers raise
            raise InputError(path, f"is no FMU that can be read ({first_line(error)})", allowed=allowed) from None
        self.version, self.kind = str(self.description.fmiVersion)[:1], self.description.coSimulation
        if self.version not in ("2", "3") or self.kind is None:
            value = f"FMI {self.description.fmiVersion}{'' if self.kind else ', for model exchange only'}"
            raise InputError(path, value, allowed=allowed)
        if fmpy.platform not in platforms:
            value = f"has binaries for {', '.join(platforms) or 'no platform'}"
            raise InputError(path, value, allowed=f"one for this platform, {fmpy.platform}")
        self.variables = {variable.name: variable for variable in self.description.modelVariables}

    def named(self, causality: str) -> list[str]:
        """Names of the variables of a causality."""
        return [name for name, variable in self.variables.items() if variable.causality == causality]

    def variable(self, name: Any, causality: str, types: Collection[str], path: str) -> Any:
        """A variable by its name, checked."""
        path, variable = f"{self.path.name}: {path}", self.variables.get(name)
        if variable is None:
            raise UnknownNameError(path, "is no variable of the FMU", value=name, allowed=self.named(causality))
        if variable.causality != causality:
            problem = f"has the causality {variable.causality or 'local'}"
            raise InputError(path, problem, value=name, allowed=f"one with {causality}")
        if variable.type not in types or variable.dimensions:
            kind = f"is {'an array' if variable.dimensions else 'a scalar'} of {variable.type}"
            raise InputError(path, kind, value=name, allowed=f"a scalar of {', '.join(types)}")
        return variable

    def calls(self, variables: Iterable[Any]) -> Calls:
        """The calls that set or get variables at once."""
        calls: dict[str, tuple[list[int], list[int]]] = {}
        for place, variable in enumerate(variables):
            kind = {"Enumeration": "Integer" if self.version == "2" else "Int64"}.get(variable.type, variable.type)
            references, places = calls.setdefault(kind, ([], []))
            references.append(variable.valueReference)
            places.append(place)
        return [(kind, *lists) for kind, lists in calls.items()]

    @functools.cached_property
    def binary(self) -> Any:
        """The binary, loaded once, without an instance."""
        fmpy, self.room = _fmpy(), temporary_folder()
        kind = fmpy.fmi2.FMU2Slave if self.version == "2" else fmpy.fmi3.FMU3Slave
        names = {"guid": self.description.guid, "modelIdentifier": self.kind.modelIdentifier}
        try:
            with zipfile.ZipFile(io.BytesIO(self.content)) as packed:
                packed.extractall(self.room.name)
            return kind(**names, unzipDirectory=self.room.name, instanceName=self.path.stem, requireFunctions=False)
        except Exception as error:  # fmpy raises this class
            raise LdcError(self.path, f"its binary cannot be loaded: {first_line(error)}") from None

    def instance(self, i: int) -> Instance:
        """The i-th instance of this thread, which all designs share."""
        if i and self.kind.canBeInstantiatedOnlyOncePerProcess:
            allowed = "one scenario at a time, as in a study"
            raise InputError(self.path, "can be instantiated only once in a process", allowed=allowed)
        while len(self.instances) <= i:
            self.instances.append(Instance(self))
        return self.instances[i]


class Instance:
    """One instance of an FMU."""

    def __init__(self, fmu: Fmu) -> None:
        self.fmu, self.slave, self.reason, self.failed = fmu, copy.copy(fmu.binary), "", ""
        self.after: object = None  # The step of a law that it has taken last
        self._instantiate()

    def _log(self, *what: Any) -> None:
        """Keep what the FMU says last."""
        self.reason = what[-1].decode(errors="replace").strip() if isinstance(what[-1], bytes) else str(what[-1])

    def _instantiate(self) -> None:
        fmi2, host = _fmpy().fmi2, {}
        if self.fmu.version == "2":
            host["callbacks"] = fmi2.fmi2CallbackFunctions(
                fmi2.fmi2CallbackLoggerTYPE(self._log),
                fmi2.defaultCallbacks.allocateMemory,
                fmi2.defaultCallbacks.freeMemory,
            )
        else:
            host["logMessage"] = self._log
        try:
            self.slave.instantiate(**host)
        except Exception as error:  # fmpy raises this class
            raise LdcError(self.fmu.path, f"cannot be instantiated: {self.reason or first_line(error)}") from None

    def set(self, calls: Calls, values: Sequence[float]) -> None:
        """Set variables to values in the order that the calls were made for."""
        for kind, references, places in calls:
            python = _PYTHON.get(kind, int)
            getattr(self.slave, f"set{kind}")(references, [python(values[place]) for place in places])

    def get(self, calls: Calls) -> list[float]:
        """Values of variables, in the order that the calls were made for."""
        values: dict[int, float] = {}
        for kind, references, places in calls:
            values |= zip(places, getattr(self.slave, f"get{kind}")(references), strict=True)
        return [float(values[place]) for place in sorted(values)]

    def start(self, calls: Calls, values: Sequence[float]) -> None:
        """Begin anew with other start values."""
        self.failed, slave = "", self.slave
        if self.after is not None:
            try:
                slave.reset()
            except Exception:  # fmpy raises this class; not every tool can reset
                getattr(slave, f"fmi{self.fmu.version}FreeInstance")(slave.component)
                self._instantiate()
        self.after = self

        def begin() -> None:
            self.set(calls, values)
            if self.fmu.version == "2":
                slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()

        self.attempt(begin)

    def attempt(self, work: Callable[[], Any]) -> Any:
        """What calls of the FMU return; None from the first that fails until the next start."""
        if self.failed:
            return None
        self.reason = ""
        try:
            return work()
        except Exception as error:  # fmpy raises its own and others
            self.failed = self.reason or first_line(error)
            return None


_here: Final = threading.local()


def fmu_of(file: FileContent, content: bytes = b"") -> Fmu:
    """The FMU in this thread."""
    known: dict[str, Fmu] = vars(_here).setdefault("fmus", {})
    if file.digest not in known:
        path, content = file(), content or _read(file())
        if _digest(content) != file.digest:
            raise InputError(path, "is not the file any more that this was made of", hint="make it anew")
        known[file.digest] = Fmu(content, path)
    return known[file.digest]


def FmuLaw(
    file: str | Path,
    inputs: Mapping[str, str] | None = None,
    *,
    output: str = "delta",
    status: str | None = None,
    step: float | None = None,
    parameters: Mapping[str, float] | Iterable[str] = (),
    name: str = "",
) -> Controller:
    """Make a design of a controller that is an FMU of FMI 2.0 or 3.0 for co-simulation.

    At each sample of the loop inputs are set, the FMU is stepped over the sample time, and its output is the command.
    One instance steers each scenario; it is reset between runs. A step that fails, and an output that is no number,
    count as a failed solve, for which the command before is held.

    Raises `InputError` for a file, variable or value that cannot be used, `UnknownNameError` with the nearest name for
    signals and variables that do not exist, and `LdcError` without fmpy.

    Parameters
    ----------
    file : path
        The FMU. Its content is a part of the design's identity.
    inputs : mapping, optional
        Signal of the toolkit to input of the FMU. By default every input has the name that it has in the interface of
        ``ldc export``, as those of its FMUs have.
    output : str
        Output that is the command [rad], positive to the left.
    status : str, optional
        Whole output with the bits of ``status`` in the interface of ``ldc export``.
    step : float [s], optional
        Communication step, a whole fraction of the sample time, which is the default.
    parameters : mapping or iterable of str
        Parameters of the FMU that become gains, by default with the FMU's start values.
    name : str
        Name of the law; by default that of the file.

    Returns
    -------
    Controller
        A design; ``dataclasses.replace`` changes its gains, its class can be registered.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.FmuLaw("missing.fmu", {"e_y": "in1", "e_psi": "in2"}, output="delta", step=0.01)
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: missing.fmu: cannot be read: No such file or directory
    """
    path = Path(file).absolute()
    content = _read(Path(file))
    held = FileContent(_digest(content), path)
    fmu = fmu_of(held, content)
    if inputs is None:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            packaged = "sources/ldc_controller.h"
            header = packed.read(packaged).decode() if packaged in packed.namelist() else ""
        by_variable = _export_signals(fmu.named("input"), header, path.name)
        pairs = [(signal, variable) for variable, signal in by_variable.items()]
        status = "status" if status is None and "status" in fmu.named("output") else status
    else:
        pairs = [*inputs.items()]
    signals = tuple(_signal(signal, f"{path.name}: inputs") for signal, _ in pairs)
    numbers = (*_REALS, *_WHOLE, "Boolean")
    shown = [fmu.variable(variable, "input", numbers, f"inputs.{signal}") for signal, variable in pairs]
    outputs = [fmu.variable(output, "output", _REALS, "output")]
    outputs += [fmu.variable(status, "output", _WHOLE, "status")] if status else []
    if step is not None:
        step = checked_number("step", step, above=0.0, unit="s")
    named = dict(parameters) if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    fields, settings = [], []
    for parameter, value in named.items():
        variable = fmu.variable(parameter, "parameter", numbers, "parameters")
        settings.append(variable)
        fields.append(_parameter(variable, value))
    return _design(
        FmuController, path, "FMU", name, fields,
        file=held, signals=signals, calls=tuple(map(fmu.calls, (settings, shown, outputs))), communication_step=step,
    )  # fmt: skip


def _parameter(variable: Any, value: float | None) -> tuple[str, type, Any]:
    """The gain that a parameter of an FMU becomes."""
    name = re.sub(r"\W+", "_", variable.name).strip("_")
    if keyword.iskeyword(name) or hasattr(FmuController, name):
        name += "_"
    kind = bool if variable.type == "Boolean" else float if variable.type in _REALS else int
    start = variable.start if value is None else value
    limits = {"lower": variable.min, "upper": variable.max} if kind is not bool else {}
    ends: dict[str, Any] = {key: float(limit) for key, limit in limits.items() if limit is not None}
    if isinstance(start, str):
        start = start in ("true", "1") if kind is bool else kind(float(start))
    description = variable.description or f"parameter {variable.name}"
    return name, kind, gain(start, unit=variable.unit or "1", description=description, **ends)


@dataclasses.dataclass(frozen=True)
class FmuController(Controller):
    """Base of the classes that `FmuLaw` makes."""

    file: ClassVar[FileContent]
    signals: ClassVar[tuple[tuple[str, float], ...]]
    calls: ClassVar[tuple[Calls, Calls, Calls]]  # Of parameters, inputs and outputs
    communication_step: ClassVar[float | None]
    batch: ClassVar[int] = 50

    def prepare(self, plant: Plant) -> FmuSteering:
        """Check the step; instances are made when they are first stepped."""
        step = self.communication_step or plant.dt
        parts = round(plant.dt / step)
        if parts < 1 or abs(parts * step - plant.dt) > 1e-9 * plant.dt:
            allowed = f"the sample time of the loop, {plant.dt:g} s, or a whole fraction of it"
            raise InputError(f"{self.name}.step", value=step, allowed=allowed)
        edge = plant.model.parameters.edge_offset
        return FmuSteering(self.signals, plant.v, edge, plant.dt, self, parts, np.arange(plant.n))


@dataclasses.dataclass(frozen=True, eq=False)
class FmuState:
    """All that an FMU was shown: an instance that has gone elsewhere is brought back by showing it again."""

    shown: tuple[FloatArray, ...] = ()  # (n, i) At each sample


@dataclasses.dataclass(frozen=True)
class FmuSteering(ExternalLaw):
    """An FMU in the loop."""

    design: FmuController
    parts: int  # Communication steps of a sample
    rows: IntArray  # (n,) Instances

    def init(self, n: int) -> FmuState:
        """Nothing shown yet."""
        return FmuState()

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: FmuState
    ) -> tuple[FloatArray, FmuState, StatusArray]:
        """The outputs of the instances, stepped over a sample."""
        fmu, k = fmu_of(self.design.file), len(state.shown)
        after = FmuState((*state.shown, self.shown(t, x, preview, delta_prev, first=k == 0)))
        answers = np.full((t.size, 2), np.nan)
        bits, instances = np.zeros(t.size, dtype=np.int64), [fmu.instance(int(row)) for row in self.rows]
        for i, instance in enumerate(instances):
            for sample in range(k if k and instance.after is state else 0, k + 1):
                answer = self._sample(instance, sample, after.shown[sample][i].tolist())
            instance.after = after
            if answer is not None:
                answers[i, : len(answer)] = answer
        if t.size and k == 0 and all(instance.failed for instance in instances):
            raise LdcError(fmu.path.name, f"fails in its first step: {instances[0].failed}")
        bits = np.nan_to_num(answers[:, 1]).astype(np.int64)
        return answers[:, 0].copy(), after, _status(bits, answers[:, 0])

    def _sample(self, instance: Instance, k: int, shown: list[float]) -> list[float] | None:
        parameters, inputs, outputs = self.design.calls
        if k == 0:
            instance.start(parameters, [getattr(self.design, gain.name) for gain in self.design.gains()])

        def work() -> list[float]:
            instance.set(inputs, shown)
            step = self.dt / self.parts
            for part in range(self.parts):
                done = instance.slave.doStep((k * self.parts + part) * step, step)
                if isinstance(done, tuple) and done[1]:
                    raise RuntimeError("the FMU asks to end the simulation")
            return instance.get(outputs)

        return instance.attempt(work)  # type: ignore[no-any-return]

    def take(self, rows: IntArray, state: FmuState) -> tuple[FmuSteering, FmuState]:
        """The instances of some scenarios."""
        part = FmuState(tuple(shown[rows] for shown in state.shown))
        instances = fmu_of(self.design.file).instances
        for row in self.rows[rows]:
            if instances[row].after is state:
                instances[row].after = part
        return dataclasses.replace(self, v=self.v[rows], rows=self.rows[rows]), part


# ------------------------------------------------------------------------------------------------ C code


def compiler() -> list[str] | None:
    """The command of a C compiler; None without one."""
    if shutil.which("cc"):
        return ["cc"]
    return [sys.executable, "-P", "-m", "ziglang", "cc"] if importlib.util.find_spec("ziglang") else None


def compile_c(command: Sequence[str], folder: Path, *arguments: str, text: str = "") -> str:
    """Run the compiler in a folder, on a `text` where it is asked for; raises `LdcError` with its first error."""
    done = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, text=True, check=False, input=text)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise LdcError(" ".join(command), next((line for line in lines if "error" in line), lines[0]))
    return done.stdout


HEADER: Final = "ldc_controller.h"


def CLaw(path: str | Path, *, name: str = "") -> Controller:
    """Make a design of a controller in C with the interface of ``ldc export``.

    The header ``ldc_controller.h`` beside it declares ``ldc_inputs``, ``ldc_outputs``, ``ldc_state``, ``ldc_step`` and,
    where there is one, ``ldc_init``. Inputs have the names of that interface, any number of them; of the outputs
    ``delta`` is read, and ``status`` if there is one. The state is plain data; the code keeps nothing else.

    Raises `InputError` for a file that cannot be used, `UnknownNameError` for an input that is no signal, and
    `LdcError` without a compiler, or for what it refuses.

    Parameters
    ----------
    path : path
        The folder of an export, of which every source but ``main.c`` is compiled; a C source; or a shared library.
        The content of sources, headers or library is a part of the design's identity.
    name : str
        Name of the law; by default that of the file or folder.

    Returns
    -------
    Controller
        A design; its class can be registered.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.CLaw("missing/controller.c")
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: missing/controller.c: cannot be read: No such file or directory
    """
    path, command = Path(path), compiler()
    folder = path if path.is_dir() else path.parent
    files = sorted(file for file in folder.glob("*.c") if file.name != "main.c") if path.is_dir() else [path]
    header = folder / HEADER
    contents = [_read(file) for file in [*files, header]]
    headers = [_read(file) for file in sorted(folder.glob("*.h")) if file != header]
    if not files:
        raise InputError(path, "has no C source", allowed="a folder that ldc export wrote, a .c file or a library")
    if command is None:
        raise LdcError("cc", "is not installed", hint='pip install "ldctoolkit[export]"')
    # of the header alone: what it includes is of no interest to the interface
    text = re.sub(r"(?m)^[ \t]*#[ \t]*include.*$", "", contents[-1].decode(errors="replace"))
    declarations = compile_c(command, folder, "-E", "-P", "-x", "c", "-", text=text)
    with temporary_folder() as room:
        library = Path(room) / "controller.so"
        if files[0].suffix == ".c":
            options = ("-std=c99", "-O2", "-fPIC", "-shared", *(file.name for file in files))
            compile_c(command, folder, *options, "-o", str(library), "-lm")
        binary = _read(library) if files[0].suffix == ".c" else contents[0]
    held = FileContent(_digest(*contents, *headers), (str(header), declarations, binary))
    struct = library_of(held).inputs
    inputs = [
        name + "".join(f"[{j + 1}]" for j in place)
        for name in struct.names or ()
        for place in np.ndindex(struct[name].shape)
    ]
    signals = _export_signals(inputs, text, header.name)
    shown = tuple(_signal(signal, f"{header.name}: ldc_inputs") for signal in signals.values())
    return _design(CController, path.absolute(), "C", name, file=held, signals=shown)


class Library:
    """A C controller as this process has it."""

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
            self.state = self.ffi.sizeof("ldc_state")
        except Exception as error:  # of cffi, of its parser, of the linker
            allowed = "ldc_inputs, ldc_outputs, ldc_state and ldc_step as ldc export writes them"
            raise InputError(header, first_line(error), allowed=allowed) from None

    def _struct(self, name: str) -> np.dtype[np.void]:
        """A struct of C as NumPy sees it."""
        fields = self.ffi.typeof(name).fields
        kinds = [field.type.item if field.type.kind == "array" else field.type for _, field in fields]
        letters = ["f" if kind.cname in ("float", "double") else "iu"[kind.cname.startswith("u")] for kind in kinds]
        sizes = [(field.type.length,) if field.type.kind == "array" else () for _, field in fields]
        formats = [(f"{a}{self.ffi.sizeof(kind)}", b) for a, kind, b in zip(letters, kinds, sizes, strict=True)]
        offsets, itemsize = [field.offset for _, field in fields], self.ffi.sizeof(name)
        names = [key for key, _ in fields]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": itemsize})

    def call(self, function: Any, *structs: npt.NDArray[Any]) -> None:
        """Call a function with the i-th of each array of structs, for all i."""
        names, count = ("ldc_inputs", "ldc_state", "ldc_outputs"), structs[0].shape[0]
        cast, buffer = self.ffi.cast, self.ffi.from_buffer
        kinds = names if len(structs) == 3 else names[1:2]
        pointers = [cast(f"{kind} *", buffer(array)) for kind, array in zip(kinds, structs, strict=True)]
        for i in range(count):
            function(*(pointer + i for pointer in pointers))


library_of = functools.lru_cache(maxsize=32)(Library)


@dataclasses.dataclass(frozen=True)
class CController(Controller):
    """Base of the classes that `CLaw` makes."""

    file: ClassVar[FileContent]
    signals: ClassVar[tuple[tuple[str, float], ...]]

    def prepare(self, plant: Plant) -> CSteering:
        """Every scenario has a state of its own."""
        return CSteering(self.signals, plant.v, plant.model.parameters.edge_offset, plant.dt, self.file)


CState = tuple[bool, npt.NDArray[np.uint8]]  # whether nothing was shown yet, (n, bytes)


@dataclasses.dataclass(frozen=True)
class CSteering(ExternalLaw):
    """C code in the loop."""

    file: FileContent

    def init(self, n: int) -> CState:
        """As ``ldc_init`` leaves it."""
        library = library_of(self.file)
        state = np.zeros((n, library.state), dtype=np.uint8)
        if library.init is not None:
            library.call(library.init, state)
        return True, state

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: CState
    ) -> tuple[FloatArray, CState, StatusArray]:
        """One call of ``ldc_step`` for each scenario."""
        library, shown = library_of(self.file), self.shown(t, x, preview, delta_prev, first=state[0])
        rows, after = np.zeros(t.size, dtype=library.inputs), state[1].copy()
        out, columns = np.zeros(t.size, dtype=library.outputs), iter(shown.T)
        for name in library.inputs.names or ():
            for place in np.ndindex(rows[name].shape[1:]):
                rows[name][(slice(None), *place)] = next(columns)
        library.call(library.step, rows, after, out)
        delta = out["delta"].astype(np.float64)
        bits = out["status"] if "status" in (library.outputs.names or ()) else np.zeros(t.size, dtype=np.int64)
        return delta, (False, after), _status(bits, delta)

    def take(self, rows: IntArray, state: CState) -> tuple[CSteering, CState]:
        """The states of some scenarios."""
        return dataclasses.replace(self, v=self.v[rows]), (state[0], state[1][rows])
