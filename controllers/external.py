"""Controllers from outside of the toolkit: an FMU, or C code with the interface of ``ldc export``.

Both are shown every departure as one to the left, positive to the left (ISO 8855), and hold one instance a scenario.
Each file makes a class of its own, known by the file's content: where the file lies decides no number.
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
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.checked_files import write_whole
from ldctoolkit.control import Controller, EventStatus, Preview, SteeringLaw
from ldctoolkit.declared import Gain, gain
from ldctoolkit.errors import InputError, LdcError, UnknownNameError, first_line
from ldctoolkit.surroundings import temporary_folder
from ldctoolkit.vehicle import Plant, VehicleModel

_STATE: Final = ("e_y", "e_y_rate", "e_psi", "e_psi_rate")
_LANE: Final = ("curvature", "yaw_rate", "heading")  # also ahead, as ``curvature@0.5``
_OTHERS: Final = (
    "v", "wheel", "delta_prev", "line_left", "line_right", "line_rate", "takeover", "engage", "t",
    "frame_e_y", "frame_e_psi", "frame_new", "curvature_seen",
)  # fmt: skip
_BEYOND: Final = 100.0  # [m] At the takeover: further beyond the line than any threshold
_FAILED, _BEYOND_DELTA_MAX = 1 | 2 | 4 | 16, 8  # Bits of ``status``, as in the header of an export


@dataclasses.dataclass(frozen=True)
class _File:
    """A file by its content. What this program has of it, as its path, is no field: it decides no identity."""

    digest: str
    held: dataclasses.InitVar[Any]

    def __post_init__(self, held: Any) -> None:
        object.__setattr__(self, "_held", held)

    def __call__(self) -> Any:
        return vars(self)["_held"]


def _digest(*contents: bytes) -> str:
    return hashlib.sha256(b"".join(hashlib.sha256(content).digest() for content in contents)).hexdigest()


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None


# ------------------------------------------------------------------------------------------------ the law


def _signal(name: Any, path: str) -> tuple[str, float]:
    """A signal and its lookahead time [s]."""
    base, ahead, time = str(name).partition("@")
    if base not in (*_STATE, *_LANE, *_OTHERS):
        raise UnknownNameError(path, "is no signal", value=name, allowed=(*_STATE, *_LANE, *_OTHERS))
    try:
        if ahead and (base not in _LANE or not -10.0 <= float(time) < np.inf):
            raise ValueError
    except ValueError:
        allowed = f"{', '.join(_LANE)}, each with a lookahead time [s], as 'curvature@0.5'"
        raise InputError(path, value=name, allowed=allowed) from None
    return base, float(time or 0.0)


def _exported(names: Iterable[str], header: str, path: str) -> Iterator[tuple[str, str]]:
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

    law: ClassVar[type[_ExternalLaw]]
    file: ClassVar[_File]
    inputs: ClassVar[tuple[tuple[str, str], ...]]  # Signals, and the names of the inputs that are shown them
    outputs: ClassVar[tuple[str, ...]] = ()  # Of an FMU
    settings: ClassVar[tuple[str, ...]] = ()  # Parameters of an FMU, in the order of the gains
    communication_step: ClassVar[float | None] = None
    batch: ClassVar[int] = 50

    def prepare(self, plant: Plant) -> _ExternalLaw:
        """Check the step; instances are made when they are first used."""
        step = self.communication_step or plant.dt
        parts = round(plant.dt / step)
        if parts < 1 or abs(parts * step - plant.dt) > 1e-9 * plant.dt:
            allowed = f"the sample time of the loop, {plant.dt:g} s, or a whole fraction of it"
            raise InputError(f"{self.name}.step", value=step, allowed=allowed)
        edge = plant.model.parameters.edge_offset
        return self.law(self, plant.v, edge, plant.age, plant.dt, parts, np.arange(plant.n))


def _design(base: dict[str, Any], path: Path, kind: str, name: str, gains: Iterable[Any] = ()) -> Controller:
    """A design of a new class for one file."""
    name = name or re.sub(r"\W+", "_", path.stem).strip("_")
    title = f"{name.replace('_', ' ').capitalize()} ({kind})"
    # in no module that can be imported: it is sent by value, and known by what it holds
    names = {"name": name, "title": title, "__doc__": f"{title}.", "__module__": "external_controllers", **base}
    made = dataclasses.make_dataclass(name, gains, bases=(ExternalController,), namespace=names, frozen=True)
    return made()  # type: ignore[no-any-return]


@dataclasses.dataclass(frozen=True)
class _ExternalLaw(SteeringLaw):
    """An external controller of n scenarios; a state is empty before the first step."""

    design: ExternalController
    v: FloatArray  # (n,) [m/s]
    edge: float  # [m] Offset of the vehicle's centre when its edge is on the line
    age: float  # [s] Of the state that is seen
    dt: float
    parts: int  # Communication steps of a sample
    rows: IntArray  # (n,) Instances

    @functools.cached_property
    def _signals(self) -> list[tuple[str, float]]:
        signals = [_signal(name, "") for name, _ in self.design.inputs]
        return [("curvature", -self.age) if base == "curvature_seen" else (base, time) for base, time in signals]

    @functools.cached_property
    def preview_times(self) -> FloatArray:
        return np.unique([time for base, time in self._signals if base in _LANE])

    def init(self, n: int) -> Any:
        return ()

    def _commands(self, shown: FloatArray, state: Any) -> tuple[FloatArray, npt.NDArray[Any], Any]:
        """Commands, bits of status and the state after, for inputs (n, i)."""
        raise NotImplementedError

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: Any
    ) -> tuple[FloatArray, Any, Any]:
        line, wheel, frame = x[:, 0] - self.edge, preview.wheel, preview.frame
        if frame is None or not len(state):  # a filter that begins with the state it is shown, or that needs none
            frame = x[:, (0, 2)]
        now = dict(zip(_STATE, x.T, strict=True)) | {
            "v": self.v, "wheel": delta_prev if wheel is None else wheel, "delta_prev": delta_prev, "t": t,
            "line_left": line, "line_right": -x[:, 0] - self.edge, "line_rate": x[:, 1], "engage": np.ones(t.size),
            "takeover": line if len(state) else np.full(t.size, _BEYOND), "frame_new": np.isfinite(frame[:, 0]),
            "frame_e_y": np.nan_to_num(frame[:, 0]), "frame_e_psi": np.nan_to_num(frame[:, 1]),
        }  # fmt: skip
        shown = np.empty((t.size, len(self._signals)))
        for i, (base, time) in enumerate(self._signals):
            if base in _LANE:
                j = int(np.searchsorted(self.preview_times, time))
                ahead = preview.heading[:, j] if base == "heading" else preview.yaw_rate[:, j]
                shown[:, i] = ahead / self.v if base == "curvature" else ahead
            else:
                shown[:, i] = now[base]
        delta, bits, after = self._commands(shown, state)
        failed = ((bits & _FAILED) != 0) | ~np.isfinite(delta)
        beyond = np.where(bits & _BEYOND_DELTA_MAX, EventStatus.BEYOND_DELTA_MAX, EventStatus.OK)
        return delta, after, np.where(failed, EventStatus.SOLVER_FAILED, beyond).astype(np.int8)

    def _of(self, rows: IntArray) -> Any:
        return dataclasses.replace(self, v=self.v[rows], rows=self.rows[rows])


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
_NUMBERS: Final = (*_REALS, *_WHOLE, "Boolean")
_PYTHON: Final = {"Boolean": bool} | dict.fromkeys(_REALS, float)  # int for the others


class _Fmu:
    """An FMU as a thread of this process has it: its description and its instances."""

    def __init__(self, content: bytes, path: Path) -> None:
        fmpy, allowed = _fmpy(), "an FMU of FMI 2.0 or 3.0 for co-simulation"
        self.path, self.content, self.instances = path, content, list[_Instance]()
        self._calls: dict[tuple[str, ...], list[tuple[str, list[int], list[int]]]] = {}
        try:
            self.description = fmpy.read_model_description(io.BytesIO(content), validate=False)
            platforms = [name for name in fmpy.supported_platforms(io.BytesIO(content)) if name != "c-code"]
        except Exception as error:  # whatever its readers raise
            raise InputError(path, f"is no FMU that can be read ({first_line(error)})", allowed=allowed) from None
        self.version, self.kind = str(self.description.fmiVersion)[:1], self.description.coSimulation
        if self.version not in ("2", "3") or self.kind is None:
            problem = f"is of FMI {self.description.fmiVersion}{'' if self.kind else ', for model exchange only'}"
            raise InputError(path, problem, allowed=allowed)
        if fmpy.platform not in platforms:
            problem = f"has binaries for {', '.join(platforms) or 'no platform'}"
            raise InputError(path, problem, allowed=f"one for this platform, {fmpy.platform}")
        self.variables = {variable.name: variable for variable in self.description.modelVariables}

    def named(self, causality: str) -> list[str]:
        return [name for name, variable in self.variables.items() if variable.causality == causality]

    def check(self, name: Any, causality: str, types: Collection[str], path: str) -> Any:
        """A variable by its name; raises where it cannot be used."""
        path, variable = f"{self.path.name}: {path}", self.variables.get(name)
        if variable is None:
            raise UnknownNameError(path, "is no variable of the FMU", value=name, allowed=self.named(causality))
        if variable.causality != causality:
            problem = f"has the causality {variable.causality or 'local'}"
            raise InputError(path, problem, value=name, allowed=causality)
        if variable.type not in types or variable.dimensions:
            problem = f"is {'an array' if variable.dimensions else 'a scalar'} of {variable.type}"
            raise InputError(path, problem, value=name, allowed=f"a scalar of {', '.join(types)}")
        return variable

    def calls(self, names: tuple[str, ...]) -> list[tuple[str, list[int], list[int]]]:
        """The calls that set or get variables: type, value references, places among the names."""
        if names not in self._calls:
            calls: dict[str, tuple[list[int], list[int]]] = {}
            for place, variable in enumerate(self.variables[name] for name in names):
                kind = {"Enumeration": "Integer" if self.version == "2" else "Int64"}.get(variable.type, variable.type)
                for values, value in zip(
                    calls.setdefault(kind, ([], [])), (variable.valueReference, place), strict=True
                ):
                    values.append(value)
            self._calls[names] = [(kind, *lists) for kind, lists in calls.items()]
        return self._calls[names]

    @functools.cached_property
    def binary(self) -> Any:
        """The binary, loaded once, without an instance."""
        fmpy, self.room = _fmpy(), temporary_folder()
        kind = fmpy.fmi2.FMU2Slave if self.version == "2" else fmpy.fmi3.FMU3Slave
        names = {"guid": self.description.guid, "modelIdentifier": self.kind.modelIdentifier}
        try:
            with zipfile.ZipFile(io.BytesIO(self.content)) as packed:
                packed.extractall(self.room.name)
            return kind(**names, unzipDirectory=self.room.name, instanceName=self.path.stem)
        except Exception as error:  # fmpy raises this class
            raise LdcError(self.path, f"cannot be loaded: {first_line(error)}") from None

    def some(self, rows: Iterable[int]) -> list[_Instance]:
        """Instances of this thread, which all designs and runs share: who begins anew takes them over."""
        count = max(rows := list(rows), default=-1) + 1
        if count > 1 and self.kind.canBeInstantiatedOnlyOncePerProcess:
            raise InputError(self.path, "can be instantiated only once in a process", allowed="one scenario at a time")
        while len(self.instances) < count:
            self.instances.append(_Instance(self))
        return [self.instances[row] for row in rows]


class _Instance:
    """One instance of an FMU."""

    def __init__(self, fmu: _Fmu) -> None:
        self.fmu, self.slave, self.reason, self.failed = fmu, copy.copy(fmu.binary), "", ""
        self.after: object = None  # The state of the law, or the step, that it is in; None: not started
        self._instantiate()

    def _log(self, *what: Any) -> None:
        self.reason = what[-1].decode(errors="replace").strip() if isinstance(what[-1], bytes) else str(what[-1])

    def _instantiate(self) -> None:
        fmi2 = _fmpy().fmi2
        usual, log = fmi2.defaultCallbacks, fmi2.fmi2CallbackLoggerTYPE(self._log)
        host = fmi2.fmi2CallbackFunctions(log, usual.allocateMemory, usual.freeMemory)
        try:
            self.slave.instantiate(**({"callbacks": host} if self.fmu.version == "2" else {"logMessage": self._log}))
        except Exception as error:  # fmpy raises this class
            raise LdcError(self.fmu.path, f"cannot be instantiated: {self.reason or first_line(error)}") from None

    def set(self, names: tuple[str, ...], values: Sequence[Any]) -> None:
        for kind, references, places in self.fmu.calls(names):
            python = _PYTHON.get(kind, int)
            getattr(self.slave, f"set{kind}")(references, [python(values[place]) for place in places])

    def start(self, names: tuple[str, ...], values: Sequence[Any]) -> None:
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
            self.set(names, values)
            if self.fmu.version == "2":
                slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()

        self._attempt(begin)

    def advance(
        self,
        inputs: tuple[str, ...],
        shown: Sequence[float],
        start: float,
        step: float,
        parts: int,
        outputs: tuple[str, ...],
    ) -> list[float]:
        """Outputs after some steps with inputs that are held; NaN from the first that fails until the next start."""
        values = [np.nan] * len(outputs)

        def work() -> None:
            self.set(inputs, shown)
            for part in range(parts):
                done = self.slave.doStep(start + part * step, step)
                if isinstance(done, tuple) and done[1]:
                    raise RuntimeError("the FMU ends the simulation")
            for kind, references, places in self.fmu.calls(outputs):
                for place, value in zip(places, getattr(self.slave, f"get{kind}")(references), strict=True):
                    values[place] = float(value)

        self._attempt(work)
        return values

    def _attempt(self, work: Callable[[], None]) -> None:
        if self.failed:
            return
        self.reason = ""
        try:
            work()
        except Exception as error:  # fmpy raises its own and others
            self.failed = self.reason or first_line(error)


_here: Final = threading.local()


def _fmu_of(file: _File, content: bytes = b"") -> _Fmu:
    """The FMU in this thread."""
    known: dict[str, _Fmu] = vars(_here).setdefault("fmus", {})
    if file.digest not in known:
        path, content = file(), content or _read(file())
        if _digest(content) != file.digest:
            raise InputError(path, "is not the file any more that this was made of", hint="make it anew")
        known[file.digest] = _Fmu(content, path)
    return known[file.digest]


@dataclasses.dataclass(frozen=True)
class _FmuSteering(_ExternalLaw):
    """Its state is all that was shown: an instance that went elsewhere is brought back by showing it again."""

    def _commands(self, shown: FloatArray, state: Any) -> tuple[FloatArray, npt.NDArray[Any], Any]:
        design, n, k, after = self.design, shown.shape[0], len(state), (*state, shown)
        fmu, inputs, step = _fmu_of(design.file), tuple(name for _, name in design.inputs), self.dt / self.parts
        answers, instances = np.zeros((n, 2)), fmu.some(self.rows.tolist())
        for i, instance in enumerate(instances):
            begin = k if k and instance.after is state else 0
            if begin == 0:
                instance.start(design.settings, [getattr(design, gain.name) for gain in design.gains()])
            for sample in range(begin, k + 1):
                values = after[sample][i].tolist()
                answer = instance.advance(inputs, values, sample * self.dt, step, self.parts, design.outputs)
            answers[i, : len(answer)], instance.after = answer, after
        if n and k == 0 and all(instance.failed for instance in instances):
            raise LdcError(fmu.path.name, f"fails in its first step: {instances[0].failed}")
        return answers[:, 0].copy(), np.nan_to_num(answers[:, 1]).astype(np.int64), after

    def take(self, rows: IntArray, state: Any) -> tuple[SteeringLaw, Any]:
        law, part = self._of(rows), tuple(shown[rows] for shown in state)
        for instance in _fmu_of(self.design.file).some(law.rows.tolist()):
            instance.after = part if instance.after is state else instance.after
        return law, part


def FmuLaw(
    file: str | Path,
    inputs: Mapping[str, str] | None = None,
    *,
    output: str = "delta",
    step: float | None = None,
    parameters: Mapping[str, float] | Iterable[str] = (),
    status: str | None = None,
    name: str = "",
) -> Controller:
    """Make a design of a controller that is an FMU of FMI 2.0 or 3.0 for co-simulation.

    A step that fails and a command that is no number count as a failed solve. Raises `InputError` for a file, variable
    or value that cannot be used, `UnknownNameError` for names that do not exist, `LdcError` without fmpy.

    Parameters
    ----------
    file : path
        The FMU. Its content is a part of the design's identity.
    inputs : mapping, optional
        Signals and the inputs that are shown them; by default of the names in the interface of ``ldc export``.
    output : str
        Output that is the command [rad], positive to the left.
    step : float [s], optional
        Communication step, a whole fraction of the sample time, which is the default.
    parameters : mapping or iterable of str
        Parameters that become gains, with values, or with the start values of the FMU.
    status : str, optional
        Whole output with the bits of ``status`` in the interface of ``ldc export``.
    name : str
        Name of the law; by default that of the file.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.FmuLaw("missing.fmu", {"e_y": "in1", "e_psi": "in2"}, output="delta", step=0.01)
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: missing.fmu: cannot be read: No such file or directory
    """
    path, content = Path(file).absolute(), _read(Path(file))
    held = _File(_digest(content), path)
    fmu = _fmu_of(held, content)
    if inputs is None:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            source = f"sources/{HEADER}"
            header = packed.read(source).decode() if source in packed.namelist() else ""
        pairs = [*_exported(fmu.named("input"), header, path.name)]
        status = "status" if status is None and "status" in fmu.named("output") else status
    else:
        pairs = [*inputs.items()]
    for signal, variable in pairs:
        _signal(signal, f"{path.name}: inputs")
        fmu.check(variable, "input", _NUMBERS, f"inputs.{signal}")
    fmu.check(output, "output", _REALS, "output")
    if status is not None:
        fmu.check(status, "output", _WHOLE, "status")
    if step is not None:
        step = Gain(name="step", default=0.05, unit="s", above=0.0).check(step)
    named = parameters if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    gains = [_gain(fmu.check(key, "parameter", _NUMBERS, "parameters"), value) for key, value in named.items()]
    base = {
        "law": _FmuSteering, "file": held, "inputs": tuple(pairs), "outputs": (output, *([status] if status else [])),
        "settings": tuple(named), "communication_step": step,
        "batch": 1 if fmu.kind.canBeInstantiatedOnlyOncePerProcess else ExternalController.batch,
    }  # fmt: skip
    return _design(base, path, "FMU", name, gains)


def _gain(variable: Any, value: float | None) -> tuple[str, type, Any]:
    """The gain that a parameter of an FMU becomes."""
    name = re.sub(r"\W+", "_", variable.name).strip("_")
    name += "_" if keyword.iskeyword(name) or hasattr(ExternalController, name) else ""
    kind = _PYTHON.get(variable.type, int)
    start: Any = variable.start if value is None else value
    if isinstance(start, str):
        start = start in ("true", "1") if kind is bool else kind(float(start))
    limits = {"lower": variable.min, "upper": variable.max} if kind is not bool else {}
    ends: dict[str, Any] = {key: float(limit) for key, limit in limits.items() if limit is not None}
    description = variable.description or f"parameter {variable.name}"
    return name, kind, gain(start, unit=variable.unit or "1", description=description, **ends)


# ------------------------------------------------------------------------------------------------ FMU as a vehicle


@dataclasses.dataclass(frozen=True)
class FmuVehicle(VehicleModel):
    """A vehicle that is an FMU of FMI 2.0 or 3.0 for co-simulation, with an instance a scenario.

    Over each step its inputs are those of the middle of the step. Raises as `FmuLaw`.

    Parameters
    ----------
    file : path
        The FMU. Its content is a part of the model's identity.
    inputs : mapping
        Signals and the inputs that are shown them: delta [rad], v [m/s], v_rate [m/s^2], and of the lane
        lane_yaw_rate [rad/s] and curvature [1/m].
    outputs : mapping
        States and the outputs that they are: a_y [m/s^2], and either v_y [m/s] and yaw_rate [rad/s] of the vehicle, or
        e_y, e_y_rate, e_psi and e_psi_rate; any others beside them.
    start : mapping
        Signals, or e_y, e_y_rate, e_psi, e_psi_rate, v_y and yaw_rate, and the parameters of the FMU that are them at
        the takeover.
    step : float [s]
        Longest communication step.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.FmuVehicle("missing.fmu", {"delta": "steer"}, {"v_y": "vy", "yaw_rate": "r", "a_y": "ay"})
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: missing.fmu: cannot be read: No such file or directory
    """

    file: dataclasses.InitVar[str | Path]
    inputs: Any
    outputs: Any
    start: Any = ()
    step: float = 0.01

    def __post_init__(self, file: str | Path) -> None:
        content = _read(Path(file))
        held = _File(_digest(content), Path(file).absolute())
        fmu, moment = _fmu_of(held, content), ("delta", "v", "v_rate", "lane_yaw_rate", "curvature")
        known = {"inputs": moment, "start": (*moment, *_STATE, "v_y", "yaw_rate"), "outputs": ()}
        for table, causality in (("inputs", "input"), ("outputs", "output"), ("start", "parameter")):
            pairs = tuple(dict(getattr(self, table)).items())
            for signal, name in pairs:
                if known[table] and signal not in known[table]:
                    raise UnknownNameError(
                        f"{fmu.path.name}: {table}", "is no signal", value=signal, allowed=known[table]
                    )
                fmu.check(name, causality, _REALS if table == "outputs" else _NUMBERS, f"{table}.{signal}")
            object.__setattr__(self, table, pairs)
        names = [name for name, _ in self.outputs]
        if "a_y" not in names or not ({*_STATE} <= {*names} or {"v_y", "yaw_rate"} <= {*names}):
            allowed = f"a_y, and v_y and yaw_rate or {', '.join(_STATE)}"
            raise InputError(f"{fmu.path.name}: outputs", value=names, allowed=allowed)
        if not fmu.kind.canHandleVariableCommunicationStepSize:
            allowed = "canHandleVariableCommunicationStepSize"
            raise InputError(fmu.path, "has a fixed communication step", allowed=allowed)
        object.__setattr__(self, "step", Gain(name="step", default=0.01, unit="s", above=0.0).check(self.step))
        object.__setattr__(self, "_file", held)
        super().__post_init__()

    def code(self) -> str:
        """The content of the FMU."""
        return str(vars(self)["_file"].digest)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Outputs beyond e_y, e_y_rate, e_psi and e_psi_rate."""
        return tuple(name for name, _ in self.outputs if name not in _STATE)

    @property
    def longest_step(self) -> float:  # type: ignore[override]
        """The communication step."""
        return self.step

    def a_y(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> Any:
        """As the FMU gives it at the end of a step."""
        return x.a_y

    def initial(self, turn: Any) -> Mapping[str, Any]:
        """The single track's steady turn."""
        yaw_rate = turn.yaw_rate + turn.e_psi_rate
        a_y = turn.e_y_acceleration + turn.v * turn.yaw_rate
        values = {"v_y": self.v_y(turn, turn.v), "yaw_rate": yaw_rate, "a_y": a_y}
        return {name: value for name, value in values.items() if name in self.states}

    def begin(self, turn: Any) -> Any:
        """Instances that start at the takeover."""
        fmu, m = _fmu_of(vars(self)["_file"]), turn.v.size
        values = {name: getattr(turn, name) for name in (*_STATE, "delta", "v", "v_rate")}
        values |= {"v_y": self.v_y(turn, turn.v), "yaw_rate": turn.yaw_rate + turn.e_psi_rate}
        values |= {"lane_yaw_rate": turn.yaw_rate, "curvature": turn.yaw_rate / turn.v}
        memory = fmu.some(range(m))
        names = tuple(name for _, name in self.start)
        for i, instance in enumerate(memory):
            instance.start(names, [values[signal][i] for signal, _ in self.start])
        return memory, np.zeros(m)

    def advance(self, memory: Any, rows: IntArray, x: Any, road: Any, h: FloatArray) -> Mapping[str, Any]:
        """States after a step of the instances."""
        (instances, time), names = memory, tuple(name for _, name in self.outputs)
        shown = np.stack([getattr(road[1], signal.removeprefix("lane_")) for signal, _ in self.inputs], axis=-1)
        inputs, answers = tuple(name for _, name in self.inputs), np.empty((len(rows), len(names)))
        for k, row in enumerate(rows.tolist()):
            answers[k] = instances[row].advance(inputs, shown[k].tolist(), time[row], float(h[k]), 1, names)
        time[rows] += h
        after = dict(zip((name for name, _ in self.outputs), answers.T, strict=True))
        if {*_STATE} <= {*after}:
            return after
        return self.error_state(x, road, h, after["v_y"], after["yaw_rate"]) | after


# ------------------------------------------------------------------------------------------------ C code

HEADER: Final = "ldc_controller.h"


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


class _Library:
    """A C controller as this process has it."""

    def __init__(self, file: _File) -> None:
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
class _CSteering(_ExternalLaw):
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
    path, command = Path(path), compiler()
    folder = path if path.is_dir() else path.parent
    files = sorted(file for file in folder.glob("*.c") if file.name != "main.c") if path.is_dir() else [path]
    if not files:
        raise InputError(path, "has no C source", allowed="a folder that ldc export wrote, a C source or a library")
    contents, header = [_read(file) for file in files], _read(folder / HEADER)
    if command is None:
        raise LdcError("cc", "is not installed, and C code needs it", hint='pip install "ldctoolkit[export]"')
    # what the header includes is of no interest to the interface
    text = re.sub(r"(?m)^[ \t]*#[ \t]*include.*$", "", header.decode(errors="replace"))
    binary, declarations = contents[0], compile_c(command, folder, "-E", "-P", "-x", "c", "-", text=text)
    if files[0].suffix == ".c":
        with temporary_folder() as room:
            options = ("-std=c99", "-O2", "-fPIC", "-shared", *(file.name for file in files))
            compile_c(command, folder, *options, "-o", f"{room}/controller.so", "-lm")
            binary = _read(Path(room) / "controller.so")
    headers = map(_read, sorted(folder.glob("*.h")))
    held = _File(_digest(*contents, *headers), (folder / HEADER, declarations, binary))
    struct = _library(held).inputs
    named = [(key, place) for key in struct.names or () for place in np.ndindex(struct[key].shape)]
    inputs = tuple(_exported((key + "".join(f"[{j + 1}]" for j in place) for key, place in named), text, HEADER))
    for signal, _ in inputs:
        _signal(signal, f"{folder / HEADER}: ldc_inputs")
    return _design({"law": _CSteering, "file": held, "inputs": inputs}, path.absolute(), "C", name)
