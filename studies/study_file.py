"""The study file and the catalog: scenarios, simulation, vehicle, designs, ranking; checked before anything runs."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, get_type_hints

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, ValidationError, create_model, model_validator

from ldctoolkit.checked_files import read_toml
from ldctoolkit.control import Controller
from ldctoolkit.declared import declarations
from ldctoolkit.deprecation import Deprecation
from ldctoolkit.errors import InputError, LdcError, StudyError, UnknownNameError
from ldctoolkit.metrics import MEAN_OF_ALL, measured_on, user_rows
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.scenario_model import conditions
from ldctoolkit.setup import Setup, simulation_options
from ldctoolkit.simulation import Window
from ldctoolkit.validation import Part, as_tuples, first_problem
from ldctoolkit.vehicle import Convention, VehicleModel
from ldctoolkit.vehicle.bicycle import VehicleParameters

from .design import Design
from .design_space import DesignBlock, check_blocks, load_laws, named_laws
from .requirements import SETS, UserMetrics, criterion, loaded_metrics, metric, parse_requirement, requirements_of
from .standards import ADD_DRIVER, VEHICLES, standard_names
from .vehicle_models import MODEL, vehicle_name, with_models


def _names(entry: Any) -> Any:
    """One name or several, each once, as a tuple; what is neither stays for the check to refuse."""
    values = (entry,) if isinstance(entry, str) else entry
    if isinstance(values, list | tuple) and len(set(map(str, values))) != len(values):
        raise InputError(value=entry, allowed="each of them once")
    return tuple(values) if isinstance(values, list | tuple) else entry


def _each(read: Callable[[str], str]) -> AfterValidator:
    """A check of every text of a list, which gives the text that is kept."""

    def check(texts: tuple[str, ...]) -> tuple[str, ...]:
        values = []
        for i, text in enumerate(texts):
            try:
                values.append(read(text))
            except LdcError as error:
                raise InputError.of(error).at(f"[{i}]" if len(texts) > 1 else "") from None
        return tuple(values)

    return AfterValidator(check)


Names = Annotated[tuple[str, ...], BeforeValidator(_names)]
MetricNames = Annotated[Names, _each(lambda name: metric(name).name)]
Requirements = Annotated[Names, _each(lambda text: text if text in SETS else parse_requirement(text).text)]


def read_plant(entry: Any) -> Any:
    """The plant options of what stands under ``plant``; what is no table is handed on for the field's own message."""
    return read_table(PlantOptions, entry) if isinstance(entry, dict) else entry


def read_table(kind: type, table: dict[str, Any], prefix: str = "") -> Any:
    """A frozen value of declared fields from a table of a file; errors are at the key path behind the prefix."""
    values = dict(table)
    for key, entry in table.items():
        path, keys = f"{prefix}{key}", vars(kind)["__dataclass_fields__"]  # fps too, which is not kept
        if key not in keys:
            raise InputError(path, "no such key", allowed=[*keys])
        declaration = declarations(kind).get(key)
        if declaration and declaration.kind and not (entry is None and declaration.default is None):
            if not isinstance(entry, dict):
                raise InputError(path, value=entry, allowed="a table of keys")
            values[key] = read_table(declaration.kind, entry, f"{path}.")
    return kind(**values)


FORMER_KEYS: Final[dict[str, Deprecation]] = {}  # as ``{"ranking.old": Deprecation("1.1", "1.2", "new")}``


class RankingSettings(Part):
    """``[ranking]``."""

    # What designs are ranked by: mean S, or the mean of one of the designer's metrics over all departures
    rank_by: Annotated[str, AfterValidator(lambda name: criterion(name) and name)] = "S"
    bootstrap: int = Field(default=2000, ge=100, le=1_000_000)  # Resamples of the scenarios behind every interval
    confidence: float = Field(default=0.95, gt=0, lt=1)  # Of the intervals, all designs together
    # The design that all others are compared with beside the best: a law's name (its first design), or the start of a
    # design's identifier; empty for the design without control, if there is one
    baseline: str = ""
    # What a design must meet to be ranked: ``"a_y_peak_p95 <= 3.0"``, or the name of a set: ``"comfort"``
    require: Requirements = ()
    pareto: MetricNames = ("S", "needless", "a_y_peak_mean", "effort_mean")  # Metrics of the Pareto front
    # Named vehicles, or vehicle models as FILE.py:NAME, that `S_worst` and `comfortable_worst` are the worst of. Empty
    # for none; where a requirement, the front or the search requires one of the two, for all that have a name
    vehicles: Annotated[Names, _each(vehicle_name)] = ()
    # At most so many of the best designs are scored again on fresh scenarios; 0 for none
    finalists: int = Field(default=10, ge=0, le=1000)
    # At most so many values are added to a list of gains or thresholds, beyond the end at which the winner lies, and in
    # all at most as many designs as the study has; 0 for none
    extend: int = Field(default=0, ge=0, le=100)


class SearchSettings(Part):
    """``[search]``: designs are not written down but requested, one batch after the other."""

    method: Literal["optuna"] = "optuna"
    sampler: Literal["tpe", "random", "nsga2"] = "tpe"
    trials: int = Field(default=200, ge=1, le=100_000)  # Designs to try in all
    batch: int = Field(default=16, ge=1, le=10_000)  # Designs requested at once; they run in parallel
    # Metrics to make small (or large, where more is better): one, or several for a Pareto front
    objectives: Annotated[MetricNames, Field(min_length=1)] = ("S",)


def _conditions(entry: Any) -> Any:
    """Each a value, or (lower, upper); an infinite end is open and stored as None, which JSON knows."""
    if not isinstance(entry, dict):
        return entry
    for name, value in entry.items():
        try:
            conditions({name: value})
        except InputError as error:
            raise error.at("" if error.path == "given" else name) from None
    pairs = {name: value for name, value in entry.items() if isinstance(value, list | tuple)}
    ends = {name: tuple(None if end in (-math.inf, math.inf) else end for end in pair) for name, pair in pairs.items()}
    return entry | ends


class ScenarioSettings(Part):
    """``[scenarios]``: the model that generates them or the table that is replayed, how many, and which ones."""

    # Bundled model, or the path of a model file relative to the study file; empty where a table is replayed alone
    model: str = "reference"
    # Departures table, or one of side and eight parameters, to be replayed; beside a model, by the finalists
    departures: str = ""
    table: str = ""
    weights: str = ""  # Column of the table: events that each departure stands for
    path: Literal["parabola", "recorded"] = "parabola"  # What of recorded departures is replayed
    # Number of departures to each side: 500 of a model, all of a table
    left: int | None = Field(default=None, ge=0, le=10_000_000)
    right: int | None = Field(default=None, ge=0, le=10_000_000)
    # Only departures with these parameters: a value, or `[lower, upper]` in SI units, `inf` for open
    given: Annotated[dict[str, float | tuple[float | None, float | None]], BeforeValidator(_conditions)] = Field(
        default_factory=dict
    )

    @model_validator(mode="before")
    @classmethod
    def _source(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        if content.get("departures") or content.get("table"):
            content = {"model": ""} | content
        return content if content.get("model") == "" else {"left": 500, "right": 500} | content

    @model_validator(mode="after")
    def _some(self) -> Self:
        if self.left == self.right == 0:
            raise InputError("", "left and right are both 0", allowed="at least one scenario")
        if self.departures and self.table:
            raise InputError("table", "cannot be combined with departures", value=self.table, allowed="one of the two")
        if not (self.model or self.replayed):
            raise InputError("model", "is empty", allowed="a model, unless departures or table are given")
        if self.path == "recorded" and not self.departures:
            raise InputError("path", "needs a departures table", value=self.path, allowed="with departures")
        if self.weights and not self.replayed:
            raise InputError("weights", "needs departures or table", value=self.weights, allowed="a column of either")
        return self

    @property
    def replayed(self) -> str:
        """The table that is replayed; empty for none."""
        return self.departures or self.table

    @property
    def source(self) -> str:
        """What the scenarios come from, as a heading."""
        return "Scenario model" if self.model else "Replayed departures"

    @property
    def counts(self) -> tuple[int, int]:
        """Number of departures to each side, of a study that knows its table."""
        if self.left is None or self.right is None:
            raise InputError("scenarios", "how many departures the table holds is not known yet", hint="run the study")
        return self.left, self.right


MOST_DESIGNS = 100_000  # largest grid of one study; more is a slip of the pen


def _single(entry: Any) -> Any:
    if isinstance(entry, list | tuple):
        hint = "a study for each of the others: ldc compare compares two"
        raise InputError(value=list(entry), allowed="one value", hint=hint)
    return entry


def _file_name(name: str) -> str:
    # it names a folder by default
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}", name):
        raise InputError(value=name, allowed="up to 80 letters, digits, '-', '_' and '.', a letter or digit first")
    return name


class ScoreSettings(Part):
    """What S is: the window that it is integrated over, and the reading of the paper."""

    window: Annotated[Window, BeforeValidator(_single)] = "departure"
    convention: Annotated[Convention, BeforeValidator(_single)] = "consistent"


def _options() -> Iterator[tuple[str, Any]]:
    """The options of the simulation, as `Setup` declares them, for pydantic."""
    hints = get_type_hints(Setup)
    for option in simulation_options():
        check = dataclasses.replace(option.in_files, name="").check  # pydantic knows the name
        yield option.name, (Annotated[hints[option.name], BeforeValidator(check)], option.default)


if TYPE_CHECKING:
    SimulationSettings = ScoreSettings
else:
    SimulationSettings = create_model("SimulationSettings", __base__=ScoreSettings, **dict(_options()))
    """``[simulation]``: window and convention, and the simulation options of a `Setup`."""


class ReportSettings(Part):
    """``[report]``."""

    D_y: float = Field(default=0.5, gt=0)  # [m] The report counts departures deeper than this (paper, Table I)
    paper: bool = False  # Whether the source paper's figures are written beside it


def _vehicle(entry: Any) -> Any:
    if not isinstance(entry, dict):
        return entry
    try:
        return read_table(VehicleParameters, entry)
    except InputError as error:
        raise error.at(error.path.removeprefix("vehicle.")) from None


class Study(Part):
    """A study: what is run, on what, and how it is ranked. Made with `from_toml` or from keyword arguments.

    Raises `pydantic.ValidationError` from the constructor; `from_toml` and `from_dict` turn it into a `StudyError`.

    Examples
    --------
    >>> from ldctoolkit import Study
    >>> study = Study.from_dict({"name": "small", "design": [{"law": "none", "y_s": [0.1, 0.2]}]})
    >>> len(study.designs)
    2
    """

    name: Annotated[str, AfterValidator(_file_name)]  # Short name; letters, digits, ``-``, ``_`` and ``.``
    title: str = ""  # For people; the name by default
    seed: int = Field(default=0, ge=0, lt=2**63)  # Of the scenarios, of what is drawn for each, and of the bootstrap
    scenarios: ScenarioSettings = Field(default_factory=ScenarioSettings)
    simulation: SimulationSettings = Field(default_factory=SimulationSettings)
    vehicle: Annotated[VehicleParameters, BeforeValidator(_vehicle)] = Field(default_factory=VehicleParameters)
    # What is driven in its place, ``vehicle.model`` of a file; a `VehicleModel`, or how it was called
    vehicle_model: str = Field(default="", exclude=True)
    # What differs from the ideal plant; nothing by default
    plant: Annotated[PlantOptions, BeforeValidator(read_plant)] = Field(default_factory=PlantOptions)
    report: ReportSettings = Field(default_factory=ReportSettings)
    metrics: UserMetrics = ()  # The designer's own, whose names the tables below may use
    ranking: RankingSettings = Field(default_factory=RankingSettings)
    search: SearchSettings | None = None  # Ask for designs instead of running all that the tables stand for
    design: tuple[DesignBlock, ...]

    _folder: Path = PrivateAttr(default_factory=Path)
    _models: dict[str, VehicleModel] = PrivateAttr(default_factory=dict)

    def __repr__(self) -> str:
        designs = f"searches {', '.join(sorted({law for block in self.design for law in block.laws}))}"
        return f"<Study {self.name!r}: {designs if self.search else f'{len(self.designs):,} designs'}>"

    __str__ = __repr__

    @model_validator(mode="before")
    @classmethod
    def _front_of_the_search(cls, content: Any) -> Any:
        """Several objectives of a search are the Pareto front's metrics; its default is what designs are ranked by."""
        if not isinstance(content, dict) or not isinstance(content.get("search"), dict):
            return content
        objectives, ranking = content["search"].get("objectives"), content.get("ranking", {})
        if objectives is None and isinstance(ranking, dict) and ranking.get("rank_by", "S") != "S":
            return content | {"search": content["search"] | {"objectives": f"{ranking['rank_by']}_{MEAN_OF_ALL}"}}
        several = isinstance(objectives, list | tuple) and len(objectives) > 1
        if not several or not isinstance(ranking, dict) or "pareto" in ranking:
            return content
        return content | {"ranking": ranking | {"pareto": objectives}}

    @model_validator(mode="after")
    def _grid_size(self) -> Self:
        if not self.design:
            raise InputError("design", "no designs", allowed="one [[design]] table or more")
        check_blocks(self.design, searched=self.search is not None)
        if self.search and self.ranking.extend:
            raise InputError("ranking.extend", "is not possible with [search]", value=self.ranking.extend, allowed="0")
        size = 0 if self.search else sum(block.size for block in self.design)
        if size > MOST_DESIGNS:
            raise InputError("design", f"the grids make {size} designs", allowed=f"at most {MOST_DESIGNS}")
        return self

    @model_validator(mode="after")
    def _own_metrics(self) -> Self:
        names = [metric.name for metric in self.metrics]  # another study of this process may have others
        for text in (*self._metrics, self.ranking.rank_by):
            if (row := user_rows().get(re.split("[ <>=]", text)[0])) and row.of[0] not in names:
                raise InputError("metrics", f"without {row.of[0]}, which is named", value=text, allowed=names or "none")
        return self

    @model_validator(mode="after")
    def _measured(self) -> Self:
        objectives = self.search.objectives if self.search else ()
        named = [("ranking.require", text, limit.metric) for text in self.ranking.require
                 for limit in requirements_of([text])]  # fmt: skip
        named += [("ranking.pareto", text, metric(text)) for text in self.ranking.pareto]
        named += [("search.objectives", text, metric(text)) for text in objectives]
        for path, text, row in named:
            if not measured_on(self.plant, {text: row}):
                raise InputError(path, "needs a driver at the wheel", value=text, hint=ADD_DRIVER)
        return self

    @model_validator(mode="after")
    def _known_baseline(self) -> Self:
        # found out now, and not after a night's run
        baseline, laws = self.ranking.baseline, sorted({law for block in self.design for law in block.laws})
        identifier = re.fullmatch(r"[0-9a-f]{6,12}", baseline)
        if not baseline or baseline in laws or (identifier and self.search):
            return self
        if identifier:
            if any(design.id.startswith(baseline) for design in self.designs):
                return self
            hint = "ranking.csv lists the identifiers"
            raise InputError("ranking.baseline", "is not the start of a design's identifier", value=baseline, hint=hint)
        hint = "the start of a design's identifier is allowed, too"
        raise InputError("ranking.baseline", "is not a law of this study", value=baseline, allowed=laws, hint=hint)

    @model_validator(mode="after")
    def _valid_setup(self) -> Self:
        try:
            self.setup()
        except InputError as error:
            raise error.within("simulation") from None
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Study:
        """Read a study file.

        Raises `StudyError` naming the file, the key path, the value, what is allowed and the nearest valid name.

        Parameters
        ----------
        path : path
            TOML file.
        """
        path = Path(path)
        return cls.from_dict(read_toml(path, StudyError), source=str(path), folder=path.parent)

    @classmethod
    def from_dict(
        cls,
        content: dict[str, Any],
        *,
        source: str = "study",
        folder: str | Path | None = None,
        classes: Mapping[str, type[Controller]] | None = None,
        models: Mapping[str, VehicleModel] | None = None,
    ) -> Study:
        """Make a study from what a study file holds.

        Raises `StudyError` as in `from_toml`.

        Parameters
        ----------
        content : dict
            Keys as in the file.
        source : str
            What messages name first.
        folder : path
            Where a relative model path starts.
        classes : mapping, optional
            Classes of laws by their names; the others are looked up.
        models : mapping, optional
            Vehicle models by what the content calls them; the others are loaded from their files.
        """
        known = dict(models or {})
        for key, deprecation in FORMER_KEYS.items():
            content = deprecation.key(content, key)
        try:
            place = Path(folder or ".")
            content = load_laws(content, place, laws := dict(classes or {}))
            content = with_models(content, None if folder is None else place, known)
            if "metrics" in content:
                content = content | {"metrics": loaded_metrics(content["metrics"], place)}
            study = cls.model_validate(as_tuples(content), context=laws)
            study._models = known
            study.setup()
            if study.vehicle_model and (named := [name for name in study.vehicles if isinstance(name, str)]):
                hint = "named vehicles, S_worst's if none are given, are changes of the single track"
                raise InputError("ranking.vehicles", "with a vehicle model", value=named, allowed=MODEL, hint=hint)
        except InputError as error:
            raise StudyError.of(error.within(source, ": ")) from None
        except ValidationError as error:
            raise StudyError.of(first_problem(error, content, cls, "study").within(source, ": ")) from None
        study._folder = Path(folder or ".")
        return study

    @functools.cached_property
    def designs(self) -> tuple[Design, ...]:
        """All designs in the order written, each once; none where a search requires them."""
        if self.search is not None:
            return ()
        every = (design for block in self.design for design in block.designs())
        return tuple({design.id: design for design in every}.values())

    def setup(self) -> Setup:
        """What all runs of the study share."""
        return Setup(
            vehicle=self.vehicle,
            convention=self.simulation.convention,
            options=self.plant,
            seed=self.seed,
            vehicle_model=self._models.get(self.vehicle_model),
            **{field.name: getattr(self.simulation, field.name) for field in simulation_options()},
        )

    @property
    def _metrics(self) -> tuple[str, ...]:
        """What metrics, requirements and objectives the study names."""
        return (*self.ranking.pareto, *self.ranking.require, *(self.search.objectives if self.search else ()))

    @property
    def standards(self) -> tuple[str, ...]:
        """Tests of regulations whose scores are among them."""
        return tuple(name for name in standard_names() if any(text.startswith(name) for text in self._metrics))

    @property
    def vehicles(self) -> tuple[str | VehicleModel, ...]:
        """Named vehicles, and vehicle models, that designs are driven on beside the study's own."""
        worst = any(text.startswith(("S_worst", "comfortable_worst")) for text in self._metrics)
        names = self.ranking.vehicles or (tuple(VEHICLES) if worst else ())
        return tuple(self._models.get(name, name) for name in names)

    @property
    def vehicle_models(self) -> dict[str, VehicleModel]:
        """Vehicle models by what the study calls them."""
        return self._models

    @property
    def folder(self) -> Path:
        """Where relative paths start."""
        return self._folder

    @property
    def model_path(self) -> Path:
        """Where the model lies if it is a file and not a bundled name."""
        return self._folder / self.scenarios.model

    def changed(self, *, source: str = "study", **tables: dict[str, Any]) -> Study:
        """The same study with other entries in some of its tables."""
        content = self.content()
        return self.with_content(content | {k: content[k] | new for k, new in tables.items()}, source=source)

    def with_content(self, content: dict[str, Any], source: str = "study") -> Study:
        """Another study of the same laws, with its files in the same place."""
        return self.from_dict(content, source=source, folder=self._folder, classes=self.classes, models=self._models)

    @property
    def classes(self) -> dict[str, type[Controller]]:
        """Classes of its laws by their names; what the names stand for later does not change them."""
        return {kind.name: kind for block in self.design for kind in block.kinds}

    def laws(self) -> dict[str, str]:
        """Content of the code of each law that is not the toolkit's, as it is now."""
        return {name: content for block in self.design for name, content in block.contents().items()}

    def content(self) -> dict[str, Any]:
        """Everything in plain JSON types; `from_dict` reads it back."""
        content = self.model_dump(mode="json")
        if self.vehicle_model:
            content["vehicle"]["model"] = self.vehicle_model
        return content

    def inputs(self) -> dict[str, Any]:
        """What decides the numbers of any design: not which designs there are, the title, the report or the ranking."""
        content = self.content()
        same = {key: content[key] for key in ("seed", "simulation", "vehicle", "plant")}
        if self.plant.driver.ideal:  # it decides no number of a run
            del same["vehicle"]["steering_ratio"], same["plant"]["driver"]
        if self.vehicle_model:  # an edit of its code is the same study, which is run anew
            same["vehicle"]["model"] = type(self.vehicle_models[self.vehicle_model]).__name__
        if same["simulation"]["trigger"] == "distance":  # as before there was another
            del same["simulation"]["trigger"], same["simulation"]["ttlc"]
        keys = ["left", "right"] if self.scenarios.weights else []  # else a scenario is the same however many there are
        keys += ["given"] if self.scenarios.given else []  # the identity of a study from before there were conditions
        keys += ["path"] if self.scenarios.path == "recorded" else []
        return same | {"scenarios": {key: content["scenarios"][key] for key in keys}}

    def identity(self) -> dict[str, Any]:
        """What decides the stored numbers: `inputs`, how many scenarios there are, and the designs."""
        same = self.inputs()
        same["scenarios"] |= {"left": self.scenarios.left, "right": self.scenarios.right}
        same |= {"metrics": {metric.name: metric.code for metric in self.metrics}} if self.metrics else {}
        if self.vehicle_model:
            same["vehicle"]["model"] = self.vehicle_models[self.vehicle_model].identity
        if self.search is None:
            return same | {"designs": [design.id for design in self.designs]}
        content = self.content()
        tables = [{key: table[key] for key in table if key != "files"} for table in content["design"]]
        same |= {"search": content["search"], "design": tables}
        return same | ({"laws": laws} if (laws := self.laws()) else {})

    @property
    def hash(self) -> str:
        """Sixteen hexadecimal digits of `identity`."""
        return _digest(self.identity())

    @property
    def ranked_as(self) -> str:
        """Sixteen hexadecimal digits of what decides a ranking: `identity`, and the settings of the ranking."""
        return _digest([self.hash, self.ranking.model_dump(mode="json"), self.scenarios.model])


def _digest(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


# a list of numbers, or of one text, a line each
_LIST: Final = re.compile(r"\[\n((?:    [^\[\]{}\n\"']*,\n)+)\]|\[\n    (\"[^\"\\\n]*\"),\n\]")

_WIDTH: Final = 100


def toml_text(study: Study) -> str:
    """The study with every default written out."""
    import tomli_w

    named = [metric.source or metric.name for metric in study.metrics]  # objects have no name that a file could use
    return _LIST.sub(_on_one_line, tomli_w.dumps(_without_none(study.content() | {"metrics": named})))


def _on_one_line(match: re.Match[str]) -> str:
    line = f"[{match[2] or ' '.join(match[1].split()).removesuffix(',')}]"
    return line if len(line) <= _WIDTH else match[0]


def _without_none(value: Any) -> Any:
    """TOML has no null: what is not set is left out, and the open end of a range is infinite."""
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [(-math.inf, math.inf)[bool(i)] if item is None else _without_none(item) for i, item in enumerate(value)]
    return value


CATALOG: Final = Path(__file__).parent / "catalog"


def study(
    *designs: Controller | type[Controller] | str | dict[str, Any],
    y_s: float | Sequence[float] = 0.2,
    name: str = "study",
    left: int = 500,
    right: int = 500,
    require: str | Sequence[str] = (),
    vehicle: VehicleParameters | None = None,
    plant: PlantOptions | None = None,
    seed: int = 0,
    **tables: Any,
) -> Study:
    """Make a study without a file. It keeps the classes that it is given, whatever bears their names later.

    Raises `StudyError` as `Study.from_dict`, `InputError` for a design that is none, or two laws of one name.

    Parameters
    ----------
    *designs : Controller, type, str or dict
        Designs, classes or names of laws, or what a ``[[design]]`` table holds, as ``{"law": LQR, "gains": {...}}``.
    y_s : float or (k,) float [m]
        Trigger thresholds of those that bring none.
    name : str
        Of the study.
    left, right : int
        Departures to each side.
    require : str or sequence of str
        Requirements, as ``"a_y_peak_p95 <= 3.0"``.
    vehicle : VehicleParameters, optional
        Table I of the paper by default.
    plant : PlantOptions, optional
        What differs from the ideal plant.
    seed : int
        Of the scenarios and the bootstrap.
    **tables
        Any other table of a study file, by its name.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> swept = {"law": "lqr", "gains": {"r_delta": [100.0, 300.0]}}
    >>> study = ldc.study(ldc.NoControl, swept, y_s=[0.1, 0.2], require="a_y_peak_p95 <= 3.0")
    >>> len(study.designs)
    5
    """
    classes: dict[str, type[Controller]] = {}
    blocks = [_block(design, y_s, classes) for design in designs]
    content: dict[str, Any] = {"name": name, "seed": seed, "design": blocks, **tables}
    given = content.get("scenarios", {})
    if not isinstance(given, dict):
        allowed, hint = "a table of keys", "your own departures go into run_study(study, scenarios=...)"
        raise InputError("scenarios", f"an object of type {type(given).__name__}", allowed=allowed, hint=hint)
    content["scenarios"] = {"left": left, "right": right, **given}
    if require != ():
        content["ranking"] = {"require": require, **content.get("ranking", {})}
    content |= {key: value for key, value in {"vehicle": vehicle, "plant": plant}.items() if value is not None}
    return Study.from_dict(content, classes=classes)


def _block(design: object, y_s: float | Sequence[float], classes: dict[str, type[Controller]]) -> dict[str, Any]:
    """A ``[[design]]`` table."""
    if isinstance(design, dict):
        return named_laws({"y_s": y_s, **design}, classes)
    table = named_laws({"law": design}, classes)
    if not isinstance(table["law"], str):
        allowed = 'a controller, its class or name, or {"law": ..., "gains": {...}}, each an argument of its own'
        raise InputError("design", value=design, allowed=allowed)
    return {"gains": {}, **table} | ({} if table["law"] == "none" else {"y_s": y_s})


def catalog_names() -> tuple[str, ...]:
    """Names of the studies in the catalog, sorted."""
    return tuple(sorted(path.stem for path in CATALOG.glob("*.toml")))


def load_study(name_or_path: str | Path) -> Study:
    """A study of the catalog by its `name_or_path`, or any other by the path of its TOML file.

    Raises `UnknownNameError` for what is neither; `StudyError` as `Study.from_toml`.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.load_study("paper")
    <Study 'paper': 2 designs>
    """
    path = Path(name_or_path)
    if str(name_or_path) in catalog_names():
        return Study.from_toml(CATALOG / f"{name_or_path}.toml")
    if path.is_dir():
        allowed = "a name in the catalog, or a TOML file"
        raise StudyError(path, "is a folder", allowed=allowed, hint="ldc rank DIR ranks the results in a folder")
    if path.suffix == ".toml" or path.exists():
        return Study.from_toml(path)
    problem = "is neither a file nor in the catalog"
    raise UnknownNameError("study", problem, value=str(name_or_path), allowed=catalog_names())
