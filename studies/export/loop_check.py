"""Software in the loop: the exported C code, compiled, steers the departures of a study in the toolkit's closed loop."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Self, cast

import numpy as np
import numpy.typing as npt

from ldctoolkit import Controller, EventStatus, LinearLaw, LinearSteps, Plant, Preview, Scenarios, SteeringLaw
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import StatusArray
from ldctoolkit.errors import LdcError
from ldctoolkit.simulation import Takeover, drive
from studies.export.c_code import FLOAT_S, HEADER, SOURCE, Code

WARNINGS: Final = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")

_EARLY = 4  # samples before the departure that the code is shown
_FURTHER = 1e-5  # [m] At the departure the edge is at the threshold; so much further, also in single precision
_VECTORS = 10  # departures in the test vectors


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """What the loop shows the code in k samples of m departures, and what the toolkit's law commands; row 0 first."""

    inputs: npt.NDArray[np.void]  # (early + k, m)
    delta: FloatArray  # (early + k, m) [rad] In the road's frame; while armed the angle of the wheels
    phase: IntArray  # (early + k, m)
    counts: BoolArray  # (early + k, m) Where the departure is still driven, and has not diverged
    takeover: Takeover  # As the code is driven: the camera without the filter, which is in the code
    S: FloatArray  # (n,) [m s]
    area_ok: BoolArray  # (n,) Departures whose S counts: they have not diverged


@dataclasses.dataclass(frozen=True)
class Check:
    """How the C code compares with the toolkit's law."""

    departures: int
    diverged: int  # Left out: the smallest rounding grows there
    steps: int
    delta: float  # [rad] Largest difference of a command, on the same inputs
    S: float  # [m s] Largest difference of S, the code in the loop
    phases: int  # Steps with another phase
    float_delta: float  # [rad] As `delta`, in single precision
    float_S: float  # [m s]
    iterations: int  # Largest of the solver
    median: float  # [s] Of a step, measured
    longest: float  # [s] Of a step, measured
    stack: int  # [bytes] Sum over all functions; 0 where the compiler does not say
    size: int  # [bytes] Code and constants
    state: int  # [bytes] Of an instance
    bounds: tuple[float, float]  # [rad]

    @property
    def passed(self) -> bool:
        """Whether everything is within its bound."""
        double, single = self.bounds
        exact = self.delta <= double and self.S <= double and self.phases == 0
        return exact and self.float_delta <= single and self.float_S <= FLOAT_S

    @property
    def lines(self) -> tuple[str, ...]:
        """For the terminal."""
        left_out = f", {self.diverged} that diverge left out" if self.diverged else ""
        solver = f"; solver: {self.iterations} iterations at most" if self.iterations else ""
        stack = f"{self.stack} bytes" if self.stack else "unknown"
        return (
            f"in the loop: {self.departures} departures{left_out}, {self.steps} steps: "
            f"{'passed' if self.passed else 'FAILED'}",
            f"  double: commands within {self.delta:.1e} rad, S within {self.S:.1e} m s (bound {self.bounds[0]:g}), "
            f"{self.phases} other phases",
            f"  single: commands within {self.float_delta:.1e} rad (bound {self.bounds[1]:g}), S within "
            f"{self.float_S:.1e} m s (bound {FLOAT_S:g})",
            f"  a step: median {1e6 * self.median:.2f} us, longest {1e6 * self.longest:.2f} us, measured on this "
            f"machine, no worst case{solver}",
            f"  stack at most {stack} (sum over functions), code and tables {self.size} bytes, state {self.state} bytes",
        )


def dtype_of(code: Code, single: bool) -> np.dtype[np.void]:
    """The struct ``ldc_inputs`` as numpy sees it."""
    kinds = {"ldc_real": "f4" if single else "f8", "int32_t": "i4"}
    return np.dtype([(name, kinds[kind], (size,) if name in ("curvature", "heading") else ()) for name, size, kind in code.inputs], align=True)


# ------------------------------------------------------------------------------------------------ compiled code


def compiler() -> list[str] | None:
    """The command of a C compiler; None without one."""
    if shutil.which("cc"):
        return ["cc"]
    return [sys.executable, "-m", "ziglang", "cc"] if importlib.util.find_spec("ziglang") else None


def compile_c(command: Sequence[str], folder: Path, *arguments: str) -> None:
    """Run the compiler in a folder; raises `LdcError` with its first line of complaint."""
    done = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise LdcError(f"{' '.join(command)}: {next((line for line in lines if 'error' in line), lines[0])}")


class Compiled:
    """The code as a library in memory."""

    def __init__(self, code: Code, command: Sequence[str], *, single: bool = False, flags: Sequence[str] = ("-O2",)) -> None:
        from studies.export.c_code import render

        import cffi

        self.code, self.dtype = code, dtype_of(code, single)
        self.outputs = np.dtype([("delta", "f4" if single else "f8"), *((name, "i4") for name in ("phase", "side", "status", "iterations"))], align=True)
        self.ffi, texts = cffi.FFI(), code.texts("")
        self.ffi.cdef("int ldc_size(int); void ldc_batch(int, void *, void *, void *, double *);")
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
            folder = Path(name)
            for file in (HEADER, SOURCE):
                (folder / file).write_text(texts[file])
            (folder / "check.c").write_text(render("check.c"))
            precision = ["-DLDC_USE_FLOAT"] if single else []
            compile_c(command, folder, *WARNINGS, *precision, "-Os", "-c", "-fstack-usage", SOURCE)
            self.size, self.stack = _sizes(folder)
            compile_c(command, folder, *WARNINGS, "-D_POSIX_C_SOURCE=199309L", *precision, *flags, "-fPIC", "-shared", SOURCE, "check.c", "-o", "ldc.so", "-lm")
            self.library: Any = self.ffi.dlopen(str(folder / "ldc.so"))
        self.state = int(self.library.ldc_size(1))
        if (self.dtype.itemsize, self.outputs.itemsize) != (self.library.ldc_size(0), self.library.ldc_size(2)):
            raise LdcError("the compiler lays structs out in another way than numpy")

    def begin(self, n: int) -> npt.NDArray[np.uint8]:
        """States of n instances, as ``ldc_init`` leaves them."""
        return np.zeros((n, self.state), dtype=np.uint8)

    def step(self, inputs: npt.NDArray[np.void], state: npt.NDArray[np.uint8], seconds: FloatArray | None = None) -> npt.NDArray[np.void]:
        """One step of n instances, in place; the outputs."""
        out, given = np.empty(inputs.size, dtype=self.outputs), np.ascontiguousarray(inputs, dtype=self.dtype)
        at = self.ffi.from_buffer
        times = self.ffi.NULL if seconds is None else self.ffi.cast("double *", at(seconds))
        self.library.ldc_batch(inputs.size, at(given), at(state), at(out), times)
        return out


def _sizes(folder: Path) -> tuple[int, int]:
    """Bytes of code and constants in the object file, and the sum of all stack frames."""
    object_file = (folder / SOURCE).with_suffix(".o")
    usage = next(iter(folder.glob("*.su")), None)
    stack = sum(int(line.split("\t")[1]) for line in usage.read_text().splitlines()) if usage else 0
    if not shutil.which("size"):
        return object_file.stat().st_size, stack
    shown = subprocess.run(["size", str(object_file)], capture_output=True, text=True, check=True).stdout.split("\n")[1]
    text, data = (int(word) for word in shown.split()[:2])
    return text + data, stack


# ------------------------------------------------------------------------------------------------ in the loop


@dataclasses.dataclass(frozen=True)
class _Law(SteeringLaw):
    """What stands in the place of a law: its preview times, and what happens at a sample."""

    times: FloatArray
    at: Any  # (k, t, x, preview, delta_prev, state) -> commands and state
    begin: Any = None

    @property
    def preview_times(self) -> FloatArray:
        return self.times

    def init(self, n: int) -> Any:
        return 0, self.begin(n) if self.begin else None

    def step(self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: Any) -> tuple[FloatArray, Any, StatusArray]:
        delta, own, status = self.at(state[0], t, x, preview, delta_prev, state[1])
        return delta, (state[0] + 1, own), status


@dataclasses.dataclass(frozen=True)
class _Stand(Controller):
    """Prepares a law that is already there, or one made of the plant."""

    name: ClassVar[str] = "exported"
    title: ClassVar[str] = "Exported"
    made: Any = None

    def prepare(self, plant: Plant) -> SteeringLaw:
        return cast(SteeringLaw, self.made(plant))


@dataclasses.dataclass(frozen=True, eq=False)
class _Host:
    """What a vehicle would give to the code at each sample: the struct of inputs of m departures."""

    code: Code
    over: Takeover  # Without the filter
    start: FloatArray  # (m, 4) State that the filter starts from

    @classmethod
    def of(cls, code: Code, whole: Takeover) -> Self:
        """From a takeover with the filter, if there is one."""
        setup = whole.setup
        if not code.filtered:
            return cls(code, whole, whole.x_0)
        sensors = dataclasses.replace(setup.options.sensors, kalman=None, period=setup.options.sensors.period or setup.dt)
        raw = setup.on(dataclasses.replace(setup.options, sensors=sensors))
        return cls(code, Takeover.build(whole.scenarios, raw, y_s=whole.y_s), whole.tables.scene[:, -4:])

    @property
    def times(self) -> FloatArray:
        """Lookahead times, last that of the state where the code has a filter."""
        times = self.code.schedule.form.times
        return np.append(times, -self.code.age) if self.code.filtered else times

    def _new(self) -> npt.NDArray[np.void]:
        return np.zeros(self.over.m, dtype=dtype_of(self.code, False))

    def early(self, back: int) -> npt.NDArray[np.void]:
        """So many samples before the departure, on the recorded path; not engaged before that began."""
        over, row, side = self.over, self._new(), self.over.triggered.side.astype(float)
        t = over.start - back * over.setup.dt
        row["v"], row["wheel"], row["engage"] = over.plant.v, side * over.delta_0, t >= 0.0
        self._lines(row, over.driven.lateral(t), over.driven.lateral_rate(t))
        return row

    def sample(self, k: int, x: FloatArray, preview: Preview) -> npt.NDArray[np.void]:
        """At sample k of the loop."""
        over, row, side = self.over, self._new(), self.over.triggered.side.astype(float)
        sensors, p = over.setup.options.sensors, self.code.schedule.form.times.size
        state = x if not self.code.filtered else self.start if k == 0 else np.zeros_like(x)
        for i, name in enumerate(("e_y", "e_y_rate", "e_psi", "e_psi_rate")):
            row[name] = side * state[:, i]
        row["v"], row["engage"], row["wheel"] = over.plant.v, 1, side * cast(FloatArray, preview.wheel)
        per_way = (side / over.plant.v)[:, None]
        row["curvature"] = per_way * preview.yaw_rate[:, :p] if p > 1 else per_way[:, :1] * preview.yaw_rate[:, :1]
        if self.code.schedule.form.heading:
            row["heading"] = side[:, None] * preview.heading[:, :p]
        if self.code.filtered:
            row["frame_e_y"], row["frame_e_psi"] = side * x[:, 0], side * x[:, 2]
            row["curvature_seen"] = per_way[:, 0] * preview.yaw_rate[:, p]
            frames = [math.floor((j * over.setup.dt - sensors.delay) / sensors.period + 1e-9) for j in (k - 1, k)]
            row["frame_new"] = k == 0 or frames[0] != frames[1]
        line, rate = x[:, 0] - over.setup.vehicle.edge_offset, x[:, 1]
        if k == 0:
            line, rate = over.driven.lateral(over.start) + _FURTHER, over.driven.lateral_rate(over.start)
        self._lines(row, line, rate)
        return row

    def _lines(self, row: npt.NDArray[np.void], line: FloatArray, rate: FloatArray) -> None:
        left, other = self.over.triggered.side > 0, -line - 2.0 * self.over.setup.vehicle.edge_offset
        row["line_left"], row["line_right"] = np.where(left, line, other), np.where(left, other, line)
        if self.code.setup.ahead:
            row["line_rate"] = np.where(left, rate, -rate)


def record(code: Code, scenarios: Scenarios) -> Recording:
    """Drive the toolkit's own law, and note what the code would be shown on the way."""
    over = Takeover.build(scenarios, code.setup, y_s=code.y_s)
    host, commands, rows = _Host.of(code, over), [], []

    def ours(plant: Plant) -> SteeringLaw:
        law = code.controller.prepare(plant)
        own = dataclasses.replace(LinearSteps.of(law, plant), measured=True) if isinstance(law, LinearLaw) else law

        def at(k: int, t: FloatArray, x: FloatArray, preview: Preview, last: FloatArray, state: Any) -> Any:
            delta, state, status = cast(SteeringLaw, own).step(t, x, preview, last, state)
            commands.append(np.where(np.isfinite(delta), delta, last))
            return delta, state, status

        return _Law(own.preview_times, at, own.init)

    def again(plant: Plant) -> SteeringLaw:
        def at(k: int, t: FloatArray, x: FloatArray, preview: Preview, last: FloatArray, state: Any) -> Any:
            rows.append(host.sample(k, x, preview))
            return commands[k], state, np.zeros(x.shape[0], dtype=np.int8)

        return _Law(host.times, at)

    outcome = drive(_Stand(made=ours), over).outcome("departure")
    drive(_Stand(made=again), host.over)
    scored = drive(code.controller, over).outcome("departure")
    good = (outcome.status != EventStatus.DIVERGED) & np.isfinite(scored.S)
    side = host.over.triggered.side.astype(float)
    inputs = np.stack([*(host.early(back) for back in range(_EARLY, 0, -1)), *rows])
    k = np.arange(-_EARLY, len(rows))[:, None]
    counts = (k < host.over.steps) & good[host.over.rows] & (inputs["engage"] != 0)
    delta = np.where(k < 0, inputs["wheel"], side * np.concatenate([np.zeros((_EARLY, side.size)), commands]))
    return Recording(inputs, delta, _phases(code, inputs, side), counts, host.over, scored.S, good)


def _phases(code: Code, inputs: npt.NDArray[np.void], side: FloatArray) -> IntArray:
    """Armed before the departure, active from it on, released from where the edge is back: worked out over all time."""
    line = np.where(side > 0, inputs["line_left"], inputs["line_right"])[_EARLY:]
    rate = side * inputs["line_rate"][_EARLY:] if code.setup.ahead else 0.0
    been_out = np.logical_or.accumulate(line >= 0.0, axis=0)
    back = (line < 0.0) & (been_out | (line + code.setup.ahead * rate <= code.y_s))
    # the phase of a step is that after it: it steers once more
    steering = 1 + np.logical_or.accumulate(back, axis=0).astype(np.int64)
    return np.concatenate([np.zeros((_EARLY, side.size), dtype=np.int64), steering])


def vectors(code: Code, recording: Recording) -> str:
    """Inputs and expected outputs of some departures of both sides, as a table for the test bench."""
    side = recording.takeover.triggered.side
    whole = np.flatnonzero(recording.counts[_EARLY])
    rows = [i for sign in (1, -1) for i in whole[side[whole] == sign][: _VECTORS // 2]]
    names = [f"{name}[{j}]" if size > 1 else name for name, size, _ in code.inputs for j in range(size)]
    lines = [",".join(["begins", *names, "delta", "phase"])]
    for i in rows:
        kept = np.flatnonzero(recording.counts[:, i])
        for k in kept:
            row = recording.inputs[k, i]
            numbers = [x for name, _, _ in code.inputs for x in np.atleast_1d(row[name]).tolist()]
            numbers = [int(k == kept[0]), *numbers, float(recording.delta[k, i]), int(recording.phase[k, i])]
            lines.append(",".join(map(repr, numbers)))
    return "\n".join(lines) + "\n"


def check(code: Code, recording: Recording, command: Sequence[str]) -> Check:
    """Compile the code and compare: on the inputs of the recording, and steering in the loop."""
    double, single = Compiled(code, command), Compiled(code, command, single=True)
    (delta, phases, iterations, seconds), (float_delta, _, _, _) = (_replayed(one, recording) for one in (double, single))
    S, float_S = (_score_gap(one, recording) for one in (double, single))
    return Check(
        departures=recording.takeover.m, diverged=int((~recording.area_ok).sum()), steps=int(recording.counts.sum()),
        delta=delta, S=S, phases=phases, float_delta=float_delta, float_S=float_S, iterations=iterations,
        median=float(np.median(seconds)), longest=float(seconds.max()), stack=double.stack, size=double.size,
        state=double.state, bounds=code.bounds,
    )  # fmt: skip


def _replayed(one: Compiled, recording: Recording) -> tuple[float, int, int, FloatArray]:
    """Largest difference of a command, other phases, most iterations, and the times of all steps."""
    state, worst, phases, iterations = one.begin(recording.takeover.m), 0.0, 0, 0
    seconds = np.zeros(recording.counts.shape)
    for k, counts in enumerate(recording.counts):
        out = one.step(recording.inputs[k], state, seconds[k])
        worst = max(worst, float(np.abs(out["delta"] - recording.delta[k])[counts].max(initial=0.0)))
        phases += int((out["phase"] != recording.phase[k])[counts].sum())
        iterations = max(iterations, int(out["iterations"][counts].max(initial=0)))
    return worst, phases, iterations, seconds[recording.counts]


def _score_gap(one: Compiled, recording: Recording) -> float:
    """Largest difference of S with the code in the loop."""
    code, over = one.code, recording.takeover
    host = dataclasses.replace(_Host.of(code, Takeover.build(over.scenarios, code.setup, y_s=code.y_s)))
    side = over.triggered.side.astype(float)

    def made(plant: Plant) -> SteeringLaw:
        def at(k: int, t: FloatArray, x: FloatArray, preview: Preview, last: FloatArray, state: Any) -> Any:
            for back in range(_EARLY, 0, -1) if k == 0 else ():
                one.step(host.early(back), state)
            out = one.step(host.sample(k, x, preview), state)
            return side * out["delta"], state, np.zeros(side.size, dtype=np.int8)

        return _Law(host.times, at, one.begin)

    S = drive(_Stand(made=made), host.over).outcome("departure").S
    return float(np.abs(S - recording.S)[recording.area_ok].max(initial=0.0))
