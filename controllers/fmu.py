"""FMUs of FMI 2.0 and 3.0 for co-simulation as controllers and as vehicles, one instance a scenario.

A thread holds one pool of instances for each FMU. A run that begins resets them. A law whose instances were reset by
another run restores their state by replaying all earlier inputs.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import io
import keyword
import re
import threading
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, SteeringLaw
from ldctoolkit.declared import Gain, gain
from ldctoolkit.errors import InputError, LdcError, UnknownNameError, expect, first_line
from ldctoolkit.surroundings import temporary_folder
from ldctoolkit.vehicle import VehicleModel

from .external import (
    HEADER,
    STATE,
    ExternalController,
    ExternalLaw,
    FileContent,
    content_digest,
    design_of,
    exported_signals,
    read_file,
    signal_of,
)


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
    """The description and the instances of an FMU, for one thread."""

    def __init__(self, content: bytes, path: Path) -> None:
        fmpy, allowed = _fmpy(), "an FMU of FMI 2.0 or 3.0 for co-simulation"
        self.path, self.content, self.instances = path, content, list[_Instance]()
        try:
            self.description = fmpy.read_model_description(io.BytesIO(content), validate=False)
            platforms = [name for name in fmpy.supported_platforms(io.BytesIO(content)) if name != "c-code"]
        except Exception as error:  # whatever its readers raise
            raise InputError(path, f"cannot be read as an FMU ({first_line(error)})", allowed=allowed) from None
        self.version, self.kind = str(self.description.fmiVersion)[:1], self.description.coSimulation
        if self.version not in ("2", "3") or self.kind is None:
            problem = f"is of FMI {self.description.fmiVersion}{'' if self.kind else ', for model exchange only'}"
            raise InputError(path, problem, allowed=allowed)
        if fmpy.platform not in platforms:
            problem = f"has binaries for {', '.join(platforms) or 'no platform'}"
            raise InputError(path, problem, allowed=f"one for this platform, {fmpy.platform}")
        self.variables = {variable.name: variable for variable in self.description.modelVariables}
        self.units = {unit.name: unit.baseUnit for unit in self.description.unitDefinitions}

    def named(self, causality: str) -> list[str]:
        return [name for name, variable in self.variables.items() if variable.causality == causality]

    def check(self, name: Any, causality: str, types: Collection[str], path: str, *, si: bool = True) -> Any:
        """A variable by its name; raises where it cannot be used."""
        path, variable = f"{self.path.name}: {path}", self.variables.get(name) if isinstance(name, str) else None
        if variable is None:
            raise UnknownNameError(path, "is not a variable of the FMU", value=name, allowed=self.named(causality))
        if variable.causality != causality:
            problem = f"has the causality {variable.causality or 'local'}"
            raise InputError(path, problem, value=name, allowed=causality)
        if variable.type not in types or variable.dimensions:
            problem = f"is {'an array' if variable.dimensions else 'a scalar'} of {variable.type}"
            raise InputError(path, problem, value=name, allowed=f"a scalar of {', '.join(types)}")
        unit = variable.unit or getattr(variable.declaredType, "unit", None) or ""
        base = self.units.get(unit)  # a unit needs no definition
        if si and (base.factor != 1.0 or base.offset if base else re.search(r"deg|°|km|mm|^g$", unit)):
            raise InputError(path, f"has the unit {unit!r}", value=name, allowed="m, rad, s and what follows from them")
        return variable

    @functools.cache  # noqa: B019  # it lives as long as its thread
    def calls(self, names: tuple[str, ...]) -> list[tuple[str, list[int], list[int]]]:
        """The calls that set or get variables: type, value references, places among the names."""
        whole = "Integer" if self.version == "2" else "Int64"
        variables, places = [self.variables[name] for name in names], dict[str, list[int]]()
        for place, variable in enumerate(variables):
            places.setdefault(variable.type.replace("Enumeration", whole), []).append(place)
        return [(kind, [variables[i].valueReference for i in rows], rows) for kind, rows in places.items()]

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

    def take_instances(self, rows: Iterable[int]) -> list[_Instance]:
        """The instances with these numbers; all designs and runs of the thread share them."""
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
        self.after: object = None  # Identifies the state that the instance is in; None before the first start
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
        """Reset, and initialize with start values."""
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

    def advance(self, shown: Mapping[str, float], outputs: tuple[str, ...], *steps: float) -> list[float]:
        """Outputs after `steps` (start, length, start, ...) with constant inputs; NaN after a failure until a reset."""
        values = [np.nan] * len(outputs)

        def work() -> None:
            self.set(tuple(shown), [*shown.values()])
            for start, length in zip(steps[::2], steps[1::2], strict=True):
                done = self.slave.doStep(start, length)
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
_STEP: Final = Gain(name="step", default=0.01, unit="s", above=0.0)


def _fmu_of(file: FileContent) -> _Fmu:
    """The FMU in this thread."""
    known: dict[str, _Fmu] = vars(_here).setdefault("fmus", {})
    if file.digest not in known:
        content = read_file(path := file())
        if content_digest(content) != file.digest:
            raise InputError(path, "has changed since the law or vehicle was made", hint="make it again")
        known[file.digest] = _Fmu(content, path)
    return known[file.digest]


@dataclasses.dataclass(frozen=True)
class _FmuSteering(ExternalLaw):
    """Its state is the sequence of all inputs, which restores an instance that another run has reset."""

    def _commands(self, shown: FloatArray, state: Any) -> tuple[FloatArray, npt.NDArray[Any], Any]:
        design, n, k, after = self.design, shown.shape[0], len(state), (*state, shown)
        fmu, dt = _fmu_of(design.file), self.plant.dt
        inputs, settings = [name for _, name in design.inputs], [getattr(design, gain.name) for gain in design.gains()]
        step = dt / self.parts
        answers, instances = np.zeros((n, 2)), fmu.take_instances(self.rows.tolist())
        for i, instance in enumerate(instances):
            begin = k if k and instance.after is state else 0
            if begin == 0:
                instance.start(design.settings, settings)
            for sample in range(begin, k + 1):
                values = dict(zip(inputs, after[sample][i].tolist(), strict=True))
                steps = [x for part in range(self.parts) for x in (sample * dt + part * step, step)]
                answer = instance.advance(values, design.outputs, *steps)
            answers[i, : len(answer)], instance.after = answer, after
        if n and k == 0 and all(instance.failed for instance in instances):
            raise LdcError(fmu.path.name, f"fails in its first step: {instances[0].failed}")
        return answers[:, 0].copy(), np.nan_to_num(answers[:, 1]).astype(np.int64), after

    def take(self, rows: IntArray, state: Any) -> tuple[SteeringLaw, Any]:
        law, part = self._of(rows), tuple(shown[rows] for shown in state)
        for instance in _fmu_of(self.design.file).take_instances(law.rows.tolist()):
            instance.after = part if instance.after is state else instance.after
        return law, part


def FmuLaw(
    file: str | Path,
    inputs: Mapping[str, str] | None = None,
    *,
    output: str = "delta",
    step: float | None = None,
    parameters: Mapping[str, float] | Sequence[str] = (),
    name: str = "",
) -> Controller:
    """Make a design of a controller that is an FMU of FMI 2.0 or 3.0 for co-simulation.

    A step that fails and a command that is not finite count as a failed solve. Raises `InputError` for a file, variable
    or value that cannot be used, `UnknownNameError` for names that do not exist, `LdcError` without fmpy.

    Parameters
    ----------
    file : path
        The FMU. Its content is a part of the design's identity.
    inputs : mapping, optional
        Signals and the inputs that are shown them. By default inputs, and an output ``status``, have the names and the
        meaning of the interface of ``ldc export``.
    output : str
        Output that is the command [rad], positive to the left.
    step : float [s], optional
        Communication step, a whole fraction of the sample time, which is the default.
    parameters : mapping or sequence of str
        Parameters that become gains, with values, or with the start values of the FMU.
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
    expect("inputs", inputs, Mapping | None)
    expect("parameters", parameters, Mapping | list | tuple)
    held = FileContent(content_digest(read_file(file)), path := Path(file).absolute())
    fmu, outputs = _fmu_of(held), [output]
    if inputs is None:
        with zipfile.ZipFile(io.BytesIO(fmu.content)) as packed:
            source = f"sources/{HEADER}"
            header = packed.read(source).decode() if source in packed.namelist() else ""
        pairs = [*exported_signals(fmu.named("input"), header, path.name)]
        outputs += ["status"] * ("status" in fmu.named("output"))
    else:
        pairs = [*inputs.items()]
    for signal, variable in pairs:
        signal_of(signal, f"{path.name}: inputs")
        fmu.check(variable, "input", _NUMBERS, f"inputs.{signal}")
    fmu.check(output, "output", _REALS, "output")
    for status in outputs[1:]:
        fmu.check(status, "output", _WHOLE, "status")
    named = parameters if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    variables = [fmu.check(key, "parameter", _NUMBERS, "parameters", si=False) for key in named]
    gains = [*map(_gain, variables, named.values())]
    base = {
        "law": _FmuSteering, "file": held, "inputs": tuple(pairs), "outputs": tuple(outputs),
        "settings": tuple(named), "communication_step": None if step is None else _STEP.check(step),
        "batch": 1 if fmu.kind.canBeInstantiatedOnlyOncePerProcess else ExternalController.batch,
    }  # fmt: skip
    return design_of(base, path, "FMU", name, gains)


def _gain(variable: Any, value: float | None) -> tuple[str, type, Any]:
    """The gain that a parameter of an FMU becomes."""
    name = re.sub(r"\W+", "_", variable.name).strip("_")
    name += "_" if keyword.iskeyword(name) or hasattr(ExternalController, name) else ""
    kind = _PYTHON.get(variable.type, int)
    start: Any = value
    if value is None:
        start = variable.start in ("true", "1") if kind is bool else kind(float(variable.start or 0.0))
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
        States and the outputs that hold them: a_y [m/s^2], and either v_y [m/s] and yaw_rate [rad/s] of the vehicle, or
        e_y, e_y_rate, e_psi and e_psi_rate; any others beside them.
    start : mapping
        Signals, or e_y, e_y_rate, e_psi, e_psi_rate, v_y and yaw_rate, and the parameters of the FMU that are set to
        their values at the takeover.
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
        held = FileContent(content_digest(read_file(file)), Path(file).absolute())
        fmu, moment = _fmu_of(held), ("delta", "v", "v_rate", "lane_yaw_rate", "curvature")
        known = {"inputs": moment, "start": (*moment, *STATE, "v_y", "yaw_rate"), "outputs": ()}
        for table, causality in (("inputs", "input"), ("outputs", "output"), ("start", "parameter")):
            expect(table, getattr(self, table), Mapping | tuple)
            pairs = tuple(dict(getattr(self, table)).items())
            for signal, name in pairs:
                if known[table] and signal not in known[table]:
                    raise UnknownNameError(
                        f"{fmu.path.name}: {table}", "is not a signal", value=signal, allowed=known[table]
                    )
                fmu.check(name, causality, _REALS if table == "outputs" else _NUMBERS, f"{table}.{signal}")
            object.__setattr__(self, table, pairs)
        names = [name for name, _ in self.outputs]
        if "a_y" not in names or not ({*STATE} <= {*names} or {"v_y", "yaw_rate"} <= {*names}):
            allowed = f"a_y, and v_y and yaw_rate or {', '.join(STATE)}"
            raise InputError(f"{fmu.path.name}: outputs", value=names, allowed=allowed)
        if not fmu.kind.canHandleVariableCommunicationStepSize:
            allowed = "canHandleVariableCommunicationStepSize"
            raise InputError(fmu.path, "has a fixed communication step", allowed=allowed)
        object.__setattr__(self, "step", _STEP.check(self.step))
        object.__setattr__(self, "_file", held)
        super().__post_init__()

    def code(self) -> str:
        """The content of the FMU."""
        return str(vars(self)["_file"].digest)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Outputs beyond e_y, e_y_rate, e_psi and e_psi_rate."""
        return tuple(name for name, _ in self.outputs if name not in STATE)

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
        values = {name: getattr(turn, name) for name in (*STATE, "delta", "v", "v_rate")}
        values |= {"v_y": self.v_y(turn, turn.v), "yaw_rate": turn.yaw_rate + turn.e_psi_rate}
        values |= {"lane_yaw_rate": turn.yaw_rate, "curvature": turn.yaw_rate / turn.v}
        memory = fmu.take_instances(range(m))
        names = tuple(name for _, name in self.start)
        for i, instance in enumerate(memory):
            instance.start(names, [values[signal][i] for signal, _ in self.start])
        return memory, np.zeros(m)

    def advance(self, memory: Any, rows: IntArray, x: Any, road: Any, h: FloatArray) -> Mapping[str, Any]:
        """States after a step of the instances."""
        (instances, time), names = memory, tuple(name for _, name in self.outputs)
        shown = {name: getattr(road[1], signal.removeprefix("lane_")) for signal, name in self.inputs}
        answers = np.empty((len(rows), len(names)))
        for k, row in enumerate(rows.tolist()):
            now = {name: float(values[k]) for name, values in shown.items()}
            answers[k] = instances[row].advance(now, names, time[row], float(h[k]))
            if reason := instances[row].failed:
                raise LdcError(instances[row].fmu.path.name, f"fails {time[row]:.3g} s after a takeover: {reason}")
        time[rows] += h
        after = dict(zip((name for name, _ in self.outputs), answers.T, strict=True))
        return after if {*STATE} <= {*after} else self.error_state(x, road, h, after["v_y"], after["yaw_rate"]) | after
