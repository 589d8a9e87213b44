"""The C code of a design: its text, the folder that holds it, and how a change of the folder is noticed."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Self

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.declared import checked_number
from ldctoolkit.errors import InputError
from ldctoolkit.setup import Setup
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE
from ldctoolkit.version import __version__

from ..design import Design
from ..storage.folder_files import output_folder, read_bytes, write_text
from .law_tables import UNITS, Gains, Schedule, c_number, generated, reals

HEADER: Final = "ldc_controller.h"
SOURCE: Final = "ldc_controller.c"
PREDICTIONS: Final = "ldc_predictions.c"
VECTORS: Final = "test_vectors.csv"

BOUND: Final = 1e-9  # [rad] Largest difference of a command in double precision, and of S in m s
MPC_BOUND: Final = 1e-7  # The same of linear MPC
FLOAT_BOUND: Final = 1e-5  # [rad] Of a command in single precision
MPC_FLOAT_BOUND: Final = 1e-3
FLOAT_S: Final = 1e-3  # [m s] Of S in single precision, driven in the loop
HOLD: Final = 0.2  # [s] So long the command is held while inputs are unusable


@dataclasses.dataclass(frozen=True)
class Origin:
    """What a study says of a design."""

    study: str  # Name
    study_hash: str
    model_hash: str
    verdict: str
    missed: tuple[str, ...] = ()  # Requirements that the design does not meet

    @property
    def lines(self) -> Iterator[str]:
        """For the header."""
        yield f"study: {self.study}, hash {self.study_hash}, scenario model {self.model_hash}"
        yield f"verdict of the study: {self.verdict}"
        if self.missed:
            yield f"NOT MET by this design, exported with --anyway: {'; '.join(self.missed)}"
        else:
            yield "requirements of the study: met"


_MEANING: Final = {
    "e_y": "[m] offset of the centre of gravity from the lane's centre", "e_y_rate": "[m/s] its rate",
    "e_psi": "[rad] heading against the lane", "e_psi_rate": "[rad/s] its rate", "v": "[m/s] speed",
    "wheel": "[rad] steering angle of the wheels at the moment of the state",
    "line_left": "[m] left edge beyond the left line, negative inside the lane",
    "line_right": "[m] right edge beyond the right line", "line_rate": "[m/s] lateral velocity, of the trigger",
    "heading": "[rad] change of the lane's heading from now until then",
    "frame_e_y": "[m] offset in the latest frame of the camera; the state above only starts the filter",
    "frame_e_psi": "[rad] heading in that frame", "frame_new": "1 if no earlier step had this frame",
    "driver_torque": "[N m] of the driver at the steering wheel, positive to the left",
    "assist_saturated": "1 if the torque of the assist was at its limit at the last sample",
    "engage": "1: steer if a departure requires it; 0: hand over",
}  # fmt: skip

Field = tuple[str, int, str]  # name, size of an array or 0, type in C


@dataclasses.dataclass(frozen=True)
class Code:
    """The C code of a design."""

    controller: Controller
    setup: Setup
    y_s: float  # [m]
    schedule: Schedule
    origin: Origin | None
    version: ClassVar[str] = __version__

    @classmethod
    def of(cls, controller: Controller, setup: Setup, y_s: float, origin: Origin | None = None) -> Self:
        """Raises `InputError` for a law that has no C code."""
        y_s = checked_number("y_s", y_s, lower=-10.0, unit="m")
        return cls(controller, setup, y_s, Schedule.of(controller, setup), origin)

    @property
    def bounds(self) -> tuple[float, float]:
        """Largest difference of a command in double and in single precision [rad]."""
        return (MPC_BOUND, MPC_FLOAT_BOUND) if self.schedule.form.law in ("mpc", "predictive") else (BOUND, FLOAT_BOUND)

    @property
    def age(self) -> float:
        """Of the state that the design sees [s], as it knows it."""
        return self.setup.plant([20.0]).age

    @property
    def filtered(self) -> bool:
        """The code has a Kalman filter."""
        return self.setup.options.sensors.kalman is not None

    @property
    def driver(self) -> dict[str, Any] | None:
        """When the assist yields to the driver, in samples; None where nobody holds the wheel."""
        driver, dt = self.setup.options.driver, self.setup.dt
        if driver.ideal:
            return None
        over, calm = (max(1, math.ceil((t - 1e-9) / dt)) for t in (driver.override_time, driver.return_after))
        back = f"and comes back after {driver.return_after:g} s without it" if driver.return_after else "for good"
        text = f"more than {driver.override_torque:g} N m for {driver.override_time:g} s overrides the assist, which"
        return {
            "torque": c_number(driver.override_torque), "share": c_number(dt / max(driver.ramp, dt)), "over": over,
            "calm": calm if driver.return_after else "INT32_MAX", "text": f"{text} leaves in {driver.ramp:g} s, {back}",
        }  # fmt: skip

    @property
    def inputs(self) -> tuple[Field, ...]:
        """Fields of the struct ``ldc_inputs``."""
        form, real = self.schedule.form, "ldc_real"
        names = ("e_y", "e_y_rate", "e_psi", "e_psi_rate", "v", "wheel", "line_left", "line_right")
        fields = [(name, 0, real) for name in (*names, *(("line_rate",) if self.setup.ahead else ()))]
        fields += [(name, form.times.size, real) for name in ("curvature", *(("heading",) if form.heading else ()))]
        if self.filtered:
            fields += [(name, 0, real) for name in ("frame_e_y", "frame_e_psi", "curvature_seen")]
            fields += [("frame_new", 0, "int32_t")]
        fields += [("driver_torque", 0, real)] if self.driver else []
        fields += [("assist_saturated", 0, "int32_t")] if self.driver and form.conditioned else []
        return (*fields, ("engage", 0, "int32_t"))

    @functools.cached_property
    def design(self) -> Design:
        """Law, gains and threshold."""
        return Design.of(self.controller, self.y_s)

    @property
    def label(self) -> str:
        """As a design's; the law need not be registered."""
        values = ((gain, getattr(self.controller, gain.name)) for gain in self.controller.gains())
        changed = [f"{gain.name}={value}" for gain, value in values if value != gain.default]
        return ", ".join([self.controller.title, f"y_s={self.y_s:g} m", *changed])

    def _banner(self, digests: dict[str, str]) -> Iterator[str]:
        p, options, form = self.setup.vehicle, self.setup.options, self.schedule.form
        actuator, (double, single) = options.actuator, self.bounds
        yield f"{self.label}: lane departure correction, generated by ldctoolkit {__version__}. Do not edit."
        yield ""
        yield f"design {self.design.id}: {self.controller.name}, y_s = {self.y_s:g} m"
        yield from _wrapped("gains: ", [f"{name} = {value}" for name, value in self.design.gains])
        yield from self.origin.lines if self.origin else ("study: none, exported from Python",)
        when = f" in {self.setup.ttlc:g} s" if self.setup.ahead else ""
        yield f"sample time: {self.setup.dt:g} s; trigger: the edge is further than y_s beyond the line{when}"
        yield from _wrapped("vehicle: ", [f"{f.name} = {getattr(p, f.name):g}" for f in dataclasses.fields(p)])
        unknown = "" if self.setup.plant_knowledge == "nominal" else ", which it does not know"
        yield f"actuator it was designed for: lag {actuator.lag:g} s, delay {actuator.delay:g} s{unknown}"
        limits = {"delta_max": actuator.delta_max, "rate_max": actuator.rate_max}
        texts = [f"{name} = {limit:g}" for name, limit in limits.items() if limit is not None]
        yield f"limits of that actuator [rad, rad/s]: {', '.join(texts) or 'none'}"
        yield f"age of the state that it sees: {self.age:g} s" + (", behind a Kalman filter" if self.filtered else "")
        yield from [f"driver: {self.driver['text']}"] if self.driver else []
        yield "gains are those of the speed at the departure and stay until ldc_step hands over"
        terms, k = self.schedule.coefficients.shape
        yield f"tables: {k} gains, {terms} Chebyshev terms over log v from {SPEED_RANGE[0]:g} to {SPEED_RANGE[1]:g} m/s"
        if self.schedule.knots.size:
            yield f"of these, {self.schedule.kinked.size} with kinks or steps: polynomials over v in pieces, between"
            yield from _wrapped("    ", [f"{v:.9g} m/s" for v in self.schedule.knots])
        yield f"largest error of a table, as a share of its gain's largest value: {self.schedule.error:.1g}"
        yield f"largest difference of a command to the toolkit's: {double:g} rad, in single precision {single:g} rad"
        if form.mpc:
            yield f"solver: at most {form.mpc['iterations']} iterations a step, by the bound of its loop"
        if form.sqp:
            programs, iterations = form.sqp["programs"], form.sqp["iterations"]
            yield f"solver: at most {programs} quadratic programs a step, {iterations} iterations each"
        yield ""
        for name, value in digests.items():
            yield f"sha256 {value} {name}"

    def texts(self, vectors: str) -> dict[str, str]:
        """Every file by its name; the header has the hashes of all, of itself with zeros in the place of its own."""
        form, sizes, ahead = self.schedule.form, self.schedule.sizes, self.setup.ahead
        known = math.floor(self.setup.plant([20.0]).delay / self.setup.dt + 1e-9)
        actuator, times_text = self.setup.options.actuator, ", ".join(f"{t:g}" for t in form.times.round(9))
        yields = form.conditioned and (self.driver is not None or actuator.delta_max is not None)
        whole = math.floor(actuator.delay / self.setup.dt + 1e-9) if actuator.delta_max is not None else 0
        offsets = np.cumsum([0, *sizes.values()]).tolist()
        values: dict[str, Any] = {
            "title": _plain(self.label), "version": __version__, "id": self.design.id, "fields": self.inputs,
            "origin": list(map(_plain, self.origin.lines)) if self.origin else [],
            "law": form.law, "mpc": form.mpc, "sqp": form.sqp, "heading": form.heading, "times": form.times,
            "times_text": times_text,
            "points": form.times.size - (2 if form.barrier else 0), "has": dict.fromkeys(UNITS, 0) | sizes,
            "c": {name: c_number(x) if isinstance(x, float) else x for name, x in form.constants.items()},
            "meaning": _MEANING | {
                "curvature": f"[1/m] of the lane in {times_text} s",
                "curvature_seen": f"[1/m] of the lane {self.age:g} s ago, where the frame was taken",
            },
            "places": [(f"AT_{name.upper()}", at, UNITS[name]) for name, at in zip(sizes, offsets, strict=False)],
            "table": list(map(reals, self.schedule.coefficients.T)), "kinked": self.schedule.kinked.tolist(),
            "knots": [c_number(v) for v in self.schedule.knots], "hold": math.ceil(HOLD / self.setup.dt - 1e-9),
            "pieces": [list(map(reals, piece.T)) for piece in self.schedule.pieces], "hold_time": f"{HOLD:g}",
            "terms": self.schedule.coefficients.shape[0], "piece_terms": self.schedule.pieces.shape[1],
            "numbers": sum(max(size, 1) for _, size, _ in self.inputs),
            "columns": offsets[-1], "span": repr(math.log(SPEED_RANGE[1] / SPEED_RANGE[0])),
            "barrier": c_number(form.barrier) if form.barrier else "", "ahead": c_number(ahead) if ahead else "",
            "filter": {"known": known} if self.filtered else None, "driver": self.driver,
            "sent": max(form.sent, known + 2 if self.filtered else 1, whole + 1 if yields else 1), "whole": whole,
            "yields": yields, "delta_max": "" if actuator.delta_max is None else c_number(actuator.delta_max),
            "sources": " ".join([SOURCE, *[PREDICTIONS] * bool(form.functions)]),
            "clips": form.law != "linear" or form.barrier > 0.0,
            "dots": form.law not in ("pid", "stanley") or form.barrier > 0.0 or self.filtered,
            "dt": c_number(self.setup.dt), "y_s": c_number(self.y_s), "v_min": c_number(SPEED_RANGE[0]),
            "v_max": c_number(SPEED_RANGE[1]), "bound": f"{self.bounds[0]:g}", "float_bound": f"{self.bounds[1]:g}",
        }  # fmt: skip
        files = {name: render(name, **values) for name in (SOURCE, "main.c", "README.md")}
        if form.functions:
            files[PREDICTIONS] = render(PREDICTIONS, code=generated(form.functions), **values)
        files |= {VECTORS: vectors} if vectors else {}
        digests = {name: digest(text.encode()) for name, text in files.items()}
        header = render(HEADER, banner=map(_plain, self._banner(digests | {HEADER: _NONE})), **values)
        return {HEADER: header.replace(_NONE, digest(header.encode())), **files}


def sources_of(texts: dict[str, str]) -> list[str]:
    """Names of the files that have to be compiled."""
    return [name for name in (SOURCE, PREDICTIONS) if name in texts]


_NONE: Final = "0" * 64
_LINE: Final = re.compile(r"^ \* sha256 ([0-9a-f]{64}) (\S+)$", re.MULTILINE)


def digest(content: bytes) -> str:
    """Its SHA-256."""
    return hashlib.sha256(content).hexdigest()


def _plain(text: str) -> str:
    """Any text as a line that can stand in a comment of C; indented where it was."""
    line = " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
    return " " * (len(text) - len(text.lstrip(" "))) + line


def _wrapped(first: str, parts: Sequence[str]) -> Iterator[str]:
    """Parts with commas, four in a line."""
    for i in range(0, len(parts), 4):
        yield (first if i == 0 else "    ") + ", ".join(parts[i : i + 4])


@functools.cache
def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader(__package__), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip


def render(name: str, **values: object) -> str:
    """A template with its values."""
    return str(_environment().get_template(name).render(**values))


def write_folder(code: Code, folder: Path, vectors: str) -> dict[str, str]:
    """Write every file of a design; raises `InputError` for a folder whose files were changed by hand."""
    if changed := changed_files(folder):
        raise InputError(folder, f"changed by hand since the export: {', '.join(changed)}", allowed="another folder")
    files = code.texts(vectors)
    others = [name for name in files if (folder / name).exists()]
    if others and HEADER not in others:
        raise InputError(folder, f"holds {', '.join(others)}, which no export wrote", allowed="an empty or new folder")
    output_folder(folder)
    (folder / "ldc_controller.fmu").unlink(missing_ok=True)  # of the export before
    for name in sorted(files, key=lambda name: name == HEADER):  # the header last: it vouches for the others
        write_text(folder / name, files[name])
    return files


def changed_files(folder: Path) -> list[str]:
    """Files of an export that are not what its header says, or are missing; none where there is no export."""
    if not (folder / HEADER).is_file():
        return []
    text = read_bytes(folder / HEADER).decode(errors="replace")
    stated = {name: value for value, name in _LINE.findall(text)}
    actual = {name: digest(read_bytes(folder / name)) if (folder / name).is_file() else "" for name in stated}
    actual[HEADER] = digest(text.replace(stated.get(HEADER, _NONE), _NONE).encode())
    return [name for name, value in actual.items() if value != stated.get(name)]


def is_stale(code: Code, folder: Path) -> bool:
    """Whether a folder holds the code of another design, study or version than this."""
    fresh = code.texts("none")
    present = {name: read_bytes(folder / name) for name in (HEADER, *sources_of(fresh)) if (folder / name).is_file()}
    return any(_LINE.sub("", text.decode(errors="replace")) != _LINE.sub("", fresh[n]) for n, text in present.items())


def parameters(code: Code, kind: str) -> str:
    """The gains of a design over speed, for those who have the law: as JSON, or as a script of MATLAB."""
    v = np.union1d(np.arange(SPEED_RANGE[0], SPEED_RANGE[1] + 1.0), code.schedule.knots)
    blocks = Gains(code.controller, code.setup).blocks(v)
    blocks = {name: blocks[name] for name in code.schedule.sizes}
    facts = {"design": code.design.id, "law": code.controller.name, "y_s_m": code.y_s, "dt_s": code.setup.dt}
    facts |= dict(code.design.gains)
    times, origin = code.schedule.form.times, list(code.origin.lines) if code.origin else []
    if kind == "json":
        tables = {name: {"unit": UNITS[name], "values": values.tolist()} for name, values in blocks.items()}
        content = {"ldctoolkit": __version__, **facts, "study": origin, "lookahead_s": times.tolist()}
        return json.dumps(content | {"speed_m_s": v.tolist(), "over_speed": tables}, indent=1) + "\n"
    lines = [f"% {_plain(line)}" for line in (f"ldctoolkit {__version__}: {code.label}", *origin)]
    lines += [f"ldc.{name} = {_in_matlab(x)};" for name, x in facts.items()]
    lines += [f"ldc.lookahead_s = {_matrix(times[None])};", f"ldc.speed_m_s = {_matrix(v[:, None])};"]
    lines += [f"ldc.{name} = {_matrix(values)}; % a row a speed; {UNITS[name]}" for name, values in blocks.items()]
    return "\n".join(lines) + "\n"


def _in_matlab(value: object) -> str:
    if isinstance(value, str):
        return "'" + _plain(value).replace("'", "''") + "'"
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _matrix(values: FloatArray) -> str:
    return "[" + "; ".join(" ".join(map(repr, row)) for row in values.tolist()) + "]"
