"""``ldc review``: checks of a design, or of the designs of a study, before anything is run."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.declared import checked_number, checked_whole
from ldctoolkit.errors import InputError, LdcError, UnknownNameError
from ldctoolkit.scenarios import SPEED_CEILING, SPEED_FLOOR

from ..tables import Column, Row, Table
from ._console import (
    Subparsers,
    argument,
    interval,
    law_with_gains,
    named,
    number,
    output_file,
    print_table,
    progress_bar,
)

if TYPE_CHECKING:
    from ldctoolkit.control import Controller
    from ldctoolkit.plant_options import PlantOptions
    from ldctoolkit.review import Finding, Review
    from ldctoolkit.review.loop_numbers import LoopNumbers
    from ldctoolkit.simulation import Takeover

    from ..design import Design
    from ..study_file import Study


_MOST_SCENARIOS = 1000
"""Departures to a side that are drawn to see at which speeds and steering angles a study triggers."""


@dataclasses.dataclass(frozen=True)
class Subject:
    """One design to review."""

    label: str
    ids: tuple[str, ...]  # designs of the study that it stands for; empty for a law by itself
    controller: Controller
    arguments: dict[str, Any]  # of `ldctoolkit.review.review`
    stored: tuple[Finding, ...] = ()  # what its results say, where it was run


def subjects(args: argparse.Namespace) -> list[Subject]:
    """The designs that the command line names, each set of gains once."""
    from ldctoolkit.registry import controller_names

    from ..design import named_designs
    from ..study_file import catalog_names, load_study

    if args.design in controller_names():
        if args.only:
            raise InputError("--design", "needs a study", hint="a law's gains are given with --gain")
        return [_law_subject(args)]
    if os.path.isfile(f"{args.design}/manifest.json"):  # noqa: PTH113 - raises nothing, whatever the name
        return list(_of_folder(args))
    known = args.design in catalog_names() or args.design.endswith(".toml")
    if not known and not os.path.isfile(args.design):  # noqa: PTH113
        names = (*controller_names(), *catalog_names())
        raise UnknownNameError("design", "is neither a law nor a study", value=args.design, allowed=names)
    if args.gain:
        raise InputError("--gain", "needs the name of a law", hint="a study has its own gains")
    study = load_study(args.design)
    designs = study.designs if args.only is None else named_designs(study.designs, [args.only])
    return list(_study_subjects(study, designs, args))


def reviewed_design(subject: Subject) -> Review:
    """The review of a subject; what a study's design raises is its fault, so that the others are reviewed too."""
    from ldctoolkit.plant_options import PlantOptions
    from ldctoolkit.review import SPEEDS, review, review_plant, without_review
    from ldctoolkit.vehicle.bicycle import BicycleModel

    arguments, stored = subject.arguments, subject.stored
    dt, options = arguments.get("dt", 0.05), arguments.get("options", PlantOptions())
    review_plant(arguments.get("model", BicycleModel()), dt, options, arguments.get("speeds", SPEEDS))
    try:
        answer = review(subject.controller, **arguments)
        return dataclasses.replace(answer, findings=(*stored, *answer.findings))
    except LdcError as error:
        if not subject.ids:
            raise
        return without_review(subject.controller, dt, error)


def _of_folder(args: argparse.Namespace) -> Iterator[Subject]:
    """The design that the verdict of a study's results names, or the one that is chosen, with what its results say."""
    from ldctoolkit.review import Finding

    from ..requirements import G, metric_values
    from ._results import Judged

    judged = Judged.read(args.design)
    ranking = judged.ranking
    for subject in _study_subjects(judged.study, judged.named(args.only and [args.only]), args):
        findings = []
        for position, design in enumerate(ranking.designs):
            if design.id not in subject.ids:
                continue
            peak, lost = (float(metric_values(name, ranking)[position]) for name in ("a_y_peak_max", "lost"))
            most = next(limit.limit for limit in ranking.limits if limit.set == "physical")
            if peak > most:
                text = f"In the stored results a_y reaches {peak:.3g} m/s^2 ({peak / G:.2g} g)"
                text += f", friction allows {most:.3g} m/s^2"
                findings.append(Finding("fault", "friction", text, peak, most, math.nan))
            if lost:
                text = f"In the stored results {lost:.0f} of {ranking.scenarios} departures diverged"
                text += ", though friction allows their path"
                findings.append(Finding("fault", "diverged", text, lost, 0.0, math.nan))
        yield dataclasses.replace(subject, stored=tuple(findings))


def _law_subject(args: argparse.Namespace) -> Subject:
    from ldctoolkit.plant_options import PlantOptions
    from ldctoolkit.review import SPEEDS

    controller = law_with_gains(args.design, args.gain)
    given = ", ".join(f"{name}={text}" for name, text in args.gain or ())
    arguments: dict[str, Any] = {"options": _plant(args, PlantOptions())}
    if args.dt is not None:
        arguments["dt"] = args.dt
    arguments["speeds"] = _speeds(args, (SPEEDS[0], SPEEDS[-1]))
    return Subject(f"{controller.title}{', ' if given else ''}{given}", (), controller, arguments)


def _plant(args: argparse.Namespace, options: PlantOptions) -> PlantOptions:
    """The plant with what the command line says of its actuator."""
    options_given = {name: getattr(args, name) for name in ("delay", "lag", "rate_max", "delta_max")}
    changed = {name: value for name, value in options_given.items() if value is not None}
    return dataclasses.replace(options, actuator=dataclasses.replace(options.actuator, **changed))


def _speeds(args: argparse.Namespace, default: tuple[float, float] | None) -> np.ndarray | None:
    ends = args.speed or default
    if ends is None:
        return None
    low, high = ends
    return np.linspace(low, high, args.points if high > low else 1)


def _study_subjects(study: Study, designs: Sequence[Design], args: argparse.Namespace) -> Iterator[Subject]:
    from ldctoolkit.simulation import Takeover

    from ..measures import trigger_speeds
    from ..runner import study_source
    from ..storage.scenario_source import with_counts

    source = study_source(study)
    settings = with_counts(study, source).scenarios
    left, right = (min(n, _MOST_SCENARIOS) for n in settings.counts)
    scenarios = source.sample(left, right, seed=study.seed, given=settings.given)
    setup = study.setup()
    options = _plant(args, setup.options)
    dt = setup.dt if args.dt is None else args.dt
    triggers = {y_s: Takeover.build(scenarios, setup, y_s=y_s) for y_s in sorted({design.y_s for design in designs})}
    speeds = _speeds(args, trigger_speeds(triggers.values()))
    groups: dict[tuple[Any, ...], list[Design]] = {}
    for design in designs:
        groups.setdefault((design.law, design.gains), []).append(design)
    for same in groups.values():
        thresholds = [design.y_s for design in same]
        arguments: dict[str, Any] = {"model": setup.model, "dt": dt, "options": options, "y_s": max(thresholds)}
        arguments["plant_knowledge"] = setup.plant_knowledge
        if speeds is not None:
            arguments["speeds"] = speeds
        angles = _angles([triggers[y_s] for y_s in thresholds])
        if angles is not None:
            arguments["delta_prev"] = angles
        name = same[0].label.replace(f"y_s={same[0].y_s:g} m", f"y_s={', '.join(f'{y:g}' for y in thresholds)} m")
        yield Subject(name, tuple(d.id for d in same), same[0].controller(setup.convention), arguments)


def _plan(subject: Subject) -> str:
    """The chart of what a design plans, on a straight departure."""
    from ldctoolkit.scenarios import Scenarios
    from ldctoolkit.setup import Setup
    from ldctoolkit.simulation import plans

    from ..pages.replay import plan_chart

    given = dict(subject.arguments)
    if "model" in given:
        given |= {"vehicle": given["model"].parameters, "convention": given["model"].convention}
    setup = Setup(**{name: value for name, value in given.items() if name in Setup.__dataclass_fields__})
    straight = Scenarios.from_arrays(T=4.0, d_y=0.8, v_mean=25.0)
    return plan_chart(plans(subject.controller, straight, given.get("y_s", 0.2), setup=setup), 0).document


def _angles(triggers: list[Takeover]) -> tuple[np.ndarray, np.ndarray] | None:
    """Steering angles at the triggers and the speeds there."""
    angles = np.concatenate([takeover.delta_0 for takeover in triggers])
    return (angles, np.concatenate([takeover.plant.v for takeover in triggers])) if angles.size else None


_OF_UNIT: Final = {
    "m_s": "v", "rad_s": "bend crossover bandwidth", "s": "slowest delay_margin", "rad": "phase_margin",
    "dB": "gain_margin gain_reduction_margin", "m": "e_y_bend e_y_bend_mismatched",
}  # fmt: skip
UNITS: Final = {name: unit for unit, names in _OF_UNIT.items() for name in names.split()}
"""Number of a loop -> unit at the end of its column; one that is not here is a pure number."""


def columns(loop: LoopNumbers | None) -> dict[str, list[Any]]:
    """Numbers of a loop by column, units in the names; empty without a loop."""
    numbers = {} if loop is None else vars(loop)
    return {f"{name}_{UNITS[name]}" if name in UNITS else name: values.tolist() for name, values in numbers.items()}


def to_json(reviews: Sequence[tuple[str, tuple[str, ...], Review]]) -> str:
    """Reviews as JSON; NaN is null, an infinite number "inf" or "-inf"."""
    content = [
        {
            "design": label,
            "ids": list(ids),
            "law": review.law,
            "gains": dict(review.gains),
            "dt_s": review.dt,
            "findings": [dataclasses.asdict(finding) for finding in review.findings],
            "loop": columns(review.loop),
            "held": {arms: columns(loop) for arms, loop in review.held},
        }
        for label, ids, review in reviews
    ]
    return json.dumps(_finite_json(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _finite_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite_json(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite_json(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


FAULT = 3  # exit code where a fault was found

Reviewed = list[tuple[str, tuple[str, ...], "Review"]]


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "review",
        help="check a design before a study",
        description="Check a law with its gains, or the designs of a study, before anything is run: closed-loop poles, "
        "gain, phase, delay and disk margins, sampling, limits, conditioning, offset in a bend. Exit code 3 where a "
        "fault was found.",
    )
    about = "name of a law, a study (name in the catalog or TOML file), or a folder that ldc run wrote"
    parser.add_argument("design", metavar="DESIGN", help=about)
    about = "a gain of the law; repeatable"
    parser.add_argument("--gain", type=named, action="append", metavar="NAME=VALUE", help=about)
    parser.add_argument("--design", dest="only", metavar="LABEL", help="only this design of the study: its label or id")
    parser.add_argument(
        "--dt",
        type=argument(checked_number, above=0.0),
        metavar="S",
        help="sample time in s (default: 0.05, or the study's)",
    )
    about = "speeds in m/s (default: 10:40, or those at the study's triggers)"
    parser.add_argument("--speed", type=_speed_range, metavar="LOW:HIGH", help=about)
    parser.add_argument(
        "--points",
        type=argument(checked_whole, lower=2, upper=1000),
        default=13,
        metavar="N",
        help="number of speeds (default: 13)",
    )
    for name, meaning in (
        ("delay", "pure delay of the actuator in s"),
        ("lag", "time constant of the actuator in s"),
        ("rate-max", "limit of its rate in rad/s"),
        ("delta-max", "limit of its angle in rad"),
    ):
        parser.add_argument(f"--{name}", type=number, metavar="X", help=f"{meaning} (default: none, or the study's)")
    about = "draw what one predictive design plans at the trigger of a departure to the left, and what comes of it"
    parser.add_argument("--plan", metavar="FILE.svg", help=about)
    parser.add_argument("--json", metavar="FILE.json", help="write numbers and findings for machines")
    parser.set_defaults(run=run)


def _speed_range(text: str) -> tuple[float, float]:
    """``LOW:HIGH`` or one speed."""
    low, high = interval(text, text) if ":" in text else (number(text),) * 2
    if low is None or high is None or not SPEED_FLOOR <= low <= high <= SPEED_CEILING:
        limits = f"{SPEED_FLOOR:g} <= LOW <= HIGH <= {SPEED_CEILING:g} [m/s]"
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: LOW:HIGH, or one speed, {limits}")
    return low, high


def run(args: argparse.Namespace) -> int:
    """Carry the command out; the exit code says whether there is a fault."""
    from ..storage.folder_files import write_text

    target = None if args.json is None else output_file(args.json, ".json", option="--json")
    drawing = None if args.plan is None else output_file(args.plan, ".svg", option="--plan")
    designs = subjects(args)
    if drawing is not None:
        if len(designs) > 1:
            raise InputError("--plan", f"{len(designs)} designs to draw", allowed="one", hint="choose it with --design")
        write_text(drawing, _plan(designs[0]))
    reviewed: Reviewed = []
    with progress_bar("reviewing") as advance:
        for done, subject in enumerate(designs):
            if advance is not None:
                advance(done, len(designs))
            reviewed.append((subject.label, subject.ids, reviewed_design(subject)))
    label, _, first = reviewed[0]
    if len(reviewed) > 1:
        print_table(_of_designs(reviewed))
    elif first.loop is None:
        print(label)
    else:
        print_table(_of_speeds(label, first.loop, first.dt))
        if first.held:
            print_table(_of_designs(reviewed))
    for label, _, review in reviewed:
        if len(reviewed) > 1:
            print(f"\n{label}")
        for finding in review.findings:
            print(f"{finding.severity}: {finding.sentence}")
        if not review.findings:
            print("no findings")
    if target is not None:
        write_text(target, to_json(reviewed))
    for path in filter(None, (drawing, target)):
        print(f"written to {path}")
    return FAULT if any(review.faults for _, _, review in reviewed) else 0


_COLUMNS: Final = {
    "v": (Column("v", "m/s", ".3g"), 1.0),
    "slowest": (Column("slowest pole", "s", ".3g"), 1.0),
    "damping": (Column("damping", form=".2f"), 1.0),
    "gain_margin": (Column("gain margin", "dB", ".1f"), 1.0),
    "phase_margin": (Column("phase margin", "deg", ".1f"), 180.0 / math.pi),
    "delay_margin": (Column("delay margin", "ms", ".0f"), 1000.0),
    "disk_margin": (Column("disk margin", form=".2f"), 1.0),
    "crossover": (Column("crossover", "rad/s", ".3g"), 1.0),
    "e_y_bend": (Column("e_y in a bend", "m", ".3f"), 1.0),
    "e_y_bend_mismatched": (Column("other tyres", "m", ".3f"), 1.0),
    "hessian_condition": (Column("condition", form=".2g"), 1.0),
}
"""Number of a loop -> its column and the factor to the column's unit."""

_WORST: Final = ("gain_margin", "phase_margin", "disk_margin", "damping", "e_y_bend", "e_y_bend_mismatched")
"""What is reported of a design among others, at its worst speed."""


def _of_speeds(label: str, loop: LoopNumbers, dt: float) -> Table:
    """Every speed of one design."""
    names = [name for name in _COLUMNS if name != "hessian_condition" or not np.isnan(loop.hessian_condition).all()]
    values = np.column_stack([_COLUMNS[name][1] * getattr(loop, name) for name in names]).tolist()
    rows = [Row(row, "" if stable else "bad") for row, stable in zip(values, loop.stable, strict=True)]
    return Table(f"{label}, dt = {dt:g} s", [_COLUMNS[name][0] for name in names], rows)


def _of_designs(reviewed: Reviewed) -> Table:
    """One row a design, and those of arms on the wheel below it: the worst of all speeds."""
    columns = [Column("design", text=True), *(_COLUMNS[name][0] for name in _WORST), Column("faults"),
               Column("warnings")]  # fmt: skip
    rows = []
    for label, _, review in reviewed:
        warnings = sum(finding.severity == "warning" for finding in review.findings)
        for name, loop in ((label, review.loop), *review.held):
            cells: list[Any] = [math.nan] * len(_WORST)
            if loop is not None and loop.stable.all():
                cells = [_COLUMNS[key][1] * _worst_value(getattr(loop, key), key) for key in _WORST]
            elif loop is not None:
                cells[0] = "unstable"
            rows.append(Row([name, *cells, *((len(review.faults), warnings) if loop is review.loop else (None, None))]))
    return Table("worst of all speeds", columns, rows)


def _worst_value(values: FloatArray, name: str) -> float:
    known = values[~np.isnan(values)]
    if not known.size:
        return math.nan
    return float(known.min() if name.endswith(("margin", "damping")) else abs(known).max())
