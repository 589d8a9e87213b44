"""Software in the loop: the exported C code, compiled, steers departures in the toolkit's closed loop."""

from __future__ import annotations

import dataclasses
import math
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import AssistState, Controller, EventStatus, LinearLaw, LinearSteps, Preview, SteeringLaw
from ldctoolkit.controllers import external
from ldctoolkit.errors import InputError
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation import Outcome, Takeover, drive
from ldctoolkit.surroundings import temporary_folder
from ldctoolkit.vehicle.bicycle import Plant

from ..storage.folder_files import write_text
from .c_code import FLOAT_S, Code, render, sources_of

WARNINGS: Final = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")

_EARLY = 4  # samples before the departure that the code is shown
_FURTHER = 1e-5  # [m] At the departure the edge is at the threshold; so much further, also in single precision
_VECTORS = 10  # departures in the test vectors

Rows = npt.NDArray[np.void]  # One struct a departure


@dataclasses.dataclass(frozen=True)
class Check:
    """How the C code compares with the toolkit's law."""

    scenarios: int
    departures: int  # Of them, those that pass the threshold
    diverged: int  # Left out: the smallest rounding grows there; and where the toolkit's solver failed
    steps: int
    delta: float  # [rad] Largest difference of a command, on the same inputs
    S: float  # [m s] Largest difference of S, the code in the loop
    phases: int  # Steps with another phase
    failed: int  # Steps, of both precisions, in which the solver of the code failed where the toolkit's did not
    float_delta: float  # [rad] As `delta`, in single precision
    float_S: float  # [m s]
    iterations: int  # Largest of the solver
    median: float  # [s] Of a step, measured
    longest: float  # [s] Of a step, measured
    stack: int  # [bytes] Sum over all functions; 0 where the compiler does not say
    size: int  # [bytes] Code and constants
    state: int  # [bytes] Of an instance
    bounds: tuple[float, float]  # [rad]
    assist: int | None = None  # Other states and authorities, of both precisions; None without a driver

    @property
    def passed(self) -> bool:
        """Whether everything is within its bound."""
        double, single = self.bounds
        exact = self.delta <= double and double >= self.S and self.phases == 0 and self.failed == 0
        return exact and not self.assist and self.float_delta <= single and self.float_S <= FLOAT_S

    @property
    def lines(self) -> tuple[str, ...]:
        """For the terminal."""
        left_out = f", {self.diverged} that diverge or whose solver failed left out" if self.diverged else ""
        assist = f"  driver: {self.assist} states and authorities of the assist differ, in both precisions together"
        solver = f"; solver: {self.iterations} iterations at most, failed in {self.failed} steps"
        return (
            f"in the loop: {self.scenarios} scenarios, {self.departures} departures{left_out}, {self.steps} steps: "
            f"{'passed' if self.passed else 'FAILED'}",
            f"  double: commands within {self.delta:.1e} rad, S within {self.S:.1e} m s of the toolkit's "
            f"(bound {self.bounds[0]:g}); {self.phases} steps in another phase",
            f"  single: commands within {self.float_delta:.1e} rad (bound {self.bounds[1]:g}), S within "
            f"{self.float_S:.1e} m s (bound {FLOAT_S:g})",
            *(() if self.assist is None else (assist,)),
            f"  a step: median {1e6 * self.median:.2f} us, longest {1e6 * self.longest:.2f} us, measured on this "
            f"machine, no worst case{solver if self.iterations else ''}",
            f"  stack {f'at most {self.stack} bytes' if self.stack else 'unknown'} (sum over functions), code and "
            f"tables {self.size} bytes, state {self.state} bytes",
        )


# ------------------------------------------------------------------------------------------------ compiled code


def struct(fields: Sequence[tuple[str, int, str]], *, single: bool = False) -> np.dtype[np.void]:
    """A struct of C as numpy sees it."""
    kinds = {"ldc_real": "f4" if single else "f8", "int32_t": "i4"}
    return np.dtype([(name, kinds[kind], (size,) if size else ()) for name, size, kind in fields], align=True)


_OUTPUTS: Final = (
    ("delta", 0, "ldc_real"),
    *((name, 0, "int32_t") for name in ("phase", "side", "status", "iterations")),
)
_ASSIST: Final = {"assist_state": "int32_t", "authority": "ldc_real"}  # Only with a driver


class Compiled:
    """The code as a library in memory."""

    def __init__(self, code: Code, command: Sequence[str], *, single: bool = False) -> None:
        import cffi

        self.code, texts = code, code.texts("")
        outputs = (*_OUTPUTS, *((name, 0, kind) for name, kind in _ASSIST.items() if code.driver))
        self.inputs, self.outputs = (struct(fields, single=single) for fields in (code.inputs, outputs))
        self.ffi = cffi.FFI()
        self.ffi.cdef("int ldc_size(int); void ldc_batch(int, void *, void *, void *, double *);")
        options = [*WARNINGS, "-D_POSIX_C_SOURCE=199309L", *(["-DLDC_USE_FLOAT"] if single else [])]
        with temporary_folder() as name:
            folder = Path(name)
            for file, text in (texts | {"check.c": render("check.c")}).items():
                write_text(folder / file, text)
            external.compile_c(command, folder, *options, "-O2", "-fPIC", "-c", "-fstack-usage", *sources_of(texts))
            self.size, self.stack = _sizes(folder)
            objects = [path.name for path in folder.glob("*.o")]
            external.compile_c(
                command, folder, *options, "-O2", "-fPIC", "-shared", *objects, "check.c", "-o", "ldc.so", "-lm"
            )
            self.library: Any = self.ffi.dlopen(str(folder / "ldc.so"))
        self.state = int(self.library.ldc_size(1))

    def begin(self, n: int) -> npt.NDArray[np.uint8]:
        """States of n instances, as ``ldc_init`` leaves them."""
        return np.zeros((n, self.state), dtype=np.uint8)

    def step(self, inputs: Rows, state: npt.NDArray[np.uint8], seconds: FloatArray | None = None) -> Rows:
        """One step of n instances, in place; the outputs."""
        out, rows = np.empty(inputs.size, dtype=self.outputs), np.ascontiguousarray(inputs, dtype=self.inputs)
        buffer = self.ffi.from_buffer
        times = self.ffi.NULL if seconds is None else buffer("double[]", seconds)
        self.library.ldc_batch(inputs.size, buffer(rows), buffer(state), buffer(out), times)
        return out


def _sizes(folder: Path) -> tuple[int, int]:
    """Bytes of code and constants in the object file, and the sum of all stack frames."""
    usage = "".join(path.read_text() for path in folder.glob("*.su"))
    stack = sum(int(line.split("\t")[1]) for line in usage.splitlines())
    compiled = sorted(folder.glob("*.o"))
    if not shutil.which("size"):
        return sum(path.stat().st_size for path in compiled), stack
    shown = subprocess.run(["size", *map(str, compiled)], capture_output=True, text=True, check=True).stdout
    return sum(int(number) for line in shown.splitlines()[1:] for number in line.split()[:2]), stack


# ------------------------------------------------------------------------------------------------ in the loop


@dataclasses.dataclass(frozen=True, eq=False)
class _Commands(Controller, SteeringLaw):
    """A law whose commands come from ``command(k, t, x, preview, delta_prev)`` at sample k."""

    name: ClassVar[str] = "exported"
    title: ClassVar[str] = "Exported"
    times: FloatArray
    command: Callable[..., FloatArray]

    def prepare(self, plant: Plant) -> SteeringLaw:  # noqa: ARG002
        return self

    @property
    def preview_times(self) -> FloatArray:
        return self.times

    def init(self, n: int) -> int:  # noqa: ARG002
        return 0

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: int
    ) -> tuple[FloatArray, int, npt.NDArray[np.int8]]:
        return self.command(state, t, x, preview, delta_prev), state + 1, np.zeros(t.size, dtype=np.int8)


@dataclasses.dataclass(frozen=True, eq=False)
class _Host:
    """What a vehicle would give to the code at each sample: the struct of inputs of m departures."""

    code: Code
    over: Takeover  # Without the filter, which is in the code
    start: FloatArray  # (m, 4) State that the filter starts from

    @classmethod
    def of(cls, code: Code, scenarios: Scenarios) -> Self:
        whole = Takeover.build(scenarios, code.setup, y_s=code.y_s)
        if not code.filtered:
            return cls(code, whole, whole.x_0)
        sensors = code.setup.options.sensors
        sensors = dataclasses.replace(sensors, kalman=None, period=sensors.period or code.setup.dt)
        raw = code.setup.on(dataclasses.replace(code.setup.options, sensors=sensors))
        return cls(code, Takeover.build(scenarios, raw, y_s=code.y_s), whole.scene[:, -4:])

    @property
    def side(self) -> FloatArray:
        return self.over.triggered.side.astype(np.float64)

    def drive(self, outward_command: Callable[[Rows, int], FloatArray], *, paths: bool = False) -> Outcome:
        """With commands that follow from the inputs and the number of the sample."""

        def command(k: int, _: FloatArray, x: FloatArray, preview: Preview, __: FloatArray) -> FloatArray:
            return outward_command(self._sample(k, x, preview), k)

        times = self.code.schedule.form.times
        times = np.append(times, -self.code.age) if self.code.filtered else times
        return drive(_Commands(times, command), self.over, trajectories=paths).outcome("departure")

    def early(self) -> list[Rows]:
        """Some samples before the departure, on the recorded path; not engaged before that began."""
        over, rows = self.over, np.zeros((_EARLY, self.over.m), dtype=struct(self.code.inputs))
        for back, row in zip(range(_EARLY, 0, -1), rows, strict=True):
            t = over.start - back * over.setup.dt
            row["v"], row["wheel"], row["engage"] = over.plant.v, self.side * over.delta_0, t >= 0.0
            self._lines(row, over.driven.lateral(t), over.driven.lateral_rate(t))
        return list(rows)

    def _sample(self, k: int, x: FloatArray, preview: Preview) -> Rows:
        over, side, form = self.over, self.side, self.code.schedule.form
        row, p, v = np.zeros(over.m, dtype=struct(self.code.inputs)), form.times.size, over.plant.v
        if over.setup.options.speed == "profile":
            v = over.driven.speed(over.start + k * over.setup.dt)
        per_way = side / v
        state = x if not self.code.filtered else self.start if k == 0 else np.zeros_like(x)
        for i, name in enumerate(("e_y", "e_y_rate", "e_psi", "e_psi_rate")):
            row[name] = side * state[:, i]
        row["v"], row["engage"], row["wheel"] = v, 1, side * np.asarray(preview.wheel)
        row["curvature"] = per_way[:, None] * preview.yaw_rate[:, :p]
        if form.heading:
            row["heading"] = side[:, None] * preview.heading[:, :p]
        if self.code.filtered:
            row["frame_e_y"], row["frame_e_psi"] = side * x[:, 0], side * x[:, 2]
            row["curvature_seen"] = per_way * preview.yaw_rate[:, p]
            sensors, dt = over.setup.options.sensors, over.setup.dt
            frames = [math.floor((j * dt - sensors.delay) / sensors.period + 1e-9) for j in (k - 1, k)]
            row["frame_new"] = k == 0 or frames[0] != frames[1]
        if self.code.driver:
            torque, limit = side * np.asarray(preview.torque), over.setup.options.driver.override_torque
            row["driver_torque"] = torque * np.where(np.abs(torque) > limit, 1.0 + 1e-6, 1.0)  # in single precision too
            if form.conditioned:
                row["assist_saturated"] = preview.yielding  # the code itself knows the other reasons
        line, rate = x[:, 0] - over.setup.vehicle.edge_offset, x[:, 1]
        if k == 0:
            line, rate = over.driven.lateral(over.start) + _FURTHER, over.driven.lateral_rate(over.start)
        self._lines(row, line, rate)
        return row

    def _lines(self, row: Rows, line: FloatArray, rate: FloatArray) -> None:
        left, opposite_line = self.side > 0.0, -line - 2.0 * self.over.setup.vehicle.edge_offset
        row["line_left"], row["line_right"] = np.where(left, line, opposite_line), np.where(left, opposite_line, line)
        if self.code.setup.ahead:
            row["line_rate"] = self.side * rate


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """What the loop shows the code in k samples of m departures, and what the toolkit's law commands."""

    host: _Host
    inputs: npt.NDArray[np.void]  # (k, m)
    delta: FloatArray  # (k, m) [rad] In the road's frame; while armed the angle of the wheels
    phase: IntArray  # (k, m)
    counts: BoolArray  # (k, m) Where the departure is still driven, and does not diverge
    S: FloatArray  # (n,) [m s] NaN where it diverges, or the toolkit's solver failed
    assist: FloatArray  # (2, k, m) State of the assist and its authority; (0, k, m) without a driver


def record(code: Code, scenarios: Scenarios) -> Recording:
    """Drive the toolkit's own law, then its commands again without the filter, to see what the code would be shown."""
    host, over = _Host.of(code, scenarios), Takeover.build(scenarios, code.setup, y_s=code.y_s)
    if not over.m:
        raise InputError("scenarios", f"no departure beyond y_s = {code.y_s:g} m", allowed="one or more")
    law = code.controller.prepare(over.plant)
    if isinstance(law, LinearLaw):
        law = dataclasses.replace(LinearSteps.of(law, over.plant), measured=True)
    assert isinstance(law, SteeringLaw)  # or it would have no C code
    commands: list[FloatArray] = []
    failed: list[BoolArray] = []
    rows, state = host.early(), law.init(over.m)

    def record_command(_: int, t: FloatArray, x: FloatArray, preview: Preview, last: FloatArray) -> FloatArray:
        nonlocal state
        delta, state, status = law.step(t, x, preview, last, state)
        failed.append(status == EventStatus.SOLVER_FAILED)
        commands.append(np.where(np.isfinite(delta), delta, last))
        return delta

    def record_inputs(row: Rows, k: int) -> FloatArray:
        rows.append(row)
        return commands[k]

    stepped = drive(_Commands(law.preview_times, record_command), over).outcome("departure")
    paths = host.drive(record_inputs, paths=code.driver is not None).trajectories
    lost = stepped.status == EventStatus.DIVERGED
    lost[over.rows] |= np.any(failed, axis=0)
    S = np.where(lost, np.nan, drive(code.controller, over).outcome("departure").S)
    inputs, k = np.stack(rows), np.arange(-_EARLY, len(commands))[:, None]
    counts = (k < over.steps) & np.isfinite(S[over.rows]) & (inputs["engage"] != 0)
    delta = np.concatenate([inputs["wheel"][:_EARLY], host.side * np.stack(commands)])
    assist = np.zeros((2 if paths else 0, *inputs.shape))
    if paths:  # at the samples: without the entry at T
        at = over.start[:, None] + code.setup.dt * np.arange(len(commands))
        entry = np.minimum((paths.t[over.rows, None] < at[..., None] - 1e-9).sum(axis=-1), paths.t.shape[1] - 1)
        for part, values in zip(assist, (paths.assist_state, paths.authority), strict=True):
            part[_EARLY:] = np.take_along_axis(np.asarray(values)[over.rows], entry, axis=1).T
        if code.schedule.form.conditioned:
            inputs["assist_saturated"] &= (assist[0] == AssistState.ACTIVE) & (assist[1] == 1.0)
    return Recording(host, inputs, delta, _phases(code, inputs, host.side), counts, S, assist)


def _phases(code: Code, inputs: npt.NDArray[np.void], side: FloatArray) -> IntArray:
    """Armed before the departure, active from it on, released from where the edge is back: worked out over all time."""
    line = np.where(side > 0, inputs["line_left"], inputs["line_right"])[_EARLY:]
    predicted_line = line
    if code.setup.ahead:
        predicted_line = line + code.setup.ahead * side * inputs["line_rate"][_EARLY:]
    back = (line < 0.0) & (np.logical_or.accumulate(line >= 0.0, axis=0) | (predicted_line <= code.y_s))
    steering = 1 + np.logical_or.accumulate(back, axis=0).astype(np.int64)
    return np.concatenate([np.zeros((_EARLY, side.size), dtype=np.int64), steering])


def vectors(recording: Recording) -> str:
    """Inputs and expected outputs of some departures of both sides, as a table for the test bench."""
    whole, side, fields = np.flatnonzero(recording.counts[_EARLY]), recording.host.side, recording.host.code.inputs
    names = [f"{name}[{j}]" if size else name for name, size, _ in fields for j in range(max(size, 1))]
    lines = [",".join(["begins", *names, "delta", "phase", *list(_ASSIST)[: len(recording.assist)]])]
    for i in [i for sign in (1, -1) for i in whole[side[whole] == sign][: _VECTORS // 2]]:
        begins = 1
        for k in np.flatnonzero(recording.counts[:, i]):
            inputs = [x for name, _, _ in fields for x in np.atleast_1d(recording.inputs[name][k, i]).tolist()]
            row = [begins, *inputs, float(recording.delta[k, i]), int(recording.phase[k, i])]
            lines.append(",".join(map(repr, [*row, *recording.assist[:, k, i].tolist()])))
            begins = 0
    return "\n".join(lines) + "\n"


def check(recording: Recording, command: Sequence[str]) -> Check:
    """Compile the code and compare: on the inputs of the recording, and steering in the loop."""
    host, counts = recording.host, recording.counts
    double, single = Compiled(host.code, command), Compiled(host.code, command, single=True)
    seconds, worst, phases, failed, iterations, assist = np.zeros(counts.shape), [0.0, 0.0], 0, 0, 0, 0
    for i, compiled in enumerate((double, single)):
        state = compiled.begin(host.over.m)
        for k, driven in enumerate(counts):
            out = compiled.step(recording.inputs[k], state, seconds[k] if compiled is double else None)[driven]
            gap = np.abs(out["delta"] - recording.delta[k, driven]).max(initial=0.0)
            worst[i] = float(np.maximum(worst[i], gap))  # a command that is not a number stays visible
            failed += int((out["status"] & 4 != 0).sum())  # LDC_SOLVER_FAILED
            for name, expected in zip(_ASSIST, recording.assist[:, k, driven], strict=False):
                assist += int((~(np.abs(out[name] - expected) <= 1e-6)).sum())
            if compiled is double:
                phase, side = recording.phase[k, driven], host.side[driven]
                phases += int(((out["phase"] != phase) | (out["side"] != np.where(phase > 0, side, 0.0))).sum())
                iterations = max(iterations, int(out["iterations"].max(initial=0)))
    S, float_S = (_score_gap(compiled, recording) for compiled in (double, single))
    return Check(
        scenarios=recording.S.size, departures=host.over.m, diverged=int(np.isnan(recording.S).sum()),
        steps=int(counts.sum()), delta=worst[0], S=S, phases=phases, failed=failed, float_delta=worst[1],
        float_S=float_S, iterations=iterations, median=float(np.median(seconds[counts])),
        longest=float(seconds[counts].max()), stack=double.stack, size=double.size, state=double.state,
        bounds=host.code.bounds, assist=assist if len(recording.assist) else None,
    )  # fmt: skip


def _score_gap(compiled: Compiled, recording: Recording) -> float:
    """Largest difference of S with the code in the loop."""
    host = recording.host
    state = compiled.begin(host.over.m)
    for row in host.early():
        compiled.step(row, state)
    S = host.drive(lambda row, _: host.side * compiled.step(row, state)["delta"]).S
    return float(np.abs(S - recording.S)[np.isfinite(recording.S)].max(initial=0.0))
