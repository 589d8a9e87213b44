"""The shape of the house: imports point down, the wheel names its packages, no circles, no module outgrows its job."""

import ast
import functools
import itertools
import re
import shutil
import sys
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import ldctoolkit
from helpers.cli import ROOT, python
from ldctoolkit import errors

CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = ("ldctoolkit", "controllers", "studies")

# bottom to top: a module may import from below, and from its own level
LEVELS = (
    (
        "ldctoolkit.arrays",
        "ldctoolkit.casadi_code",
        "ldctoolkit.code_content",
        "ldctoolkit.compiling",
        "ldctoolkit.deprecation",
        "ldctoolkit.errors",
        "ldctoolkit.vector_math",
        "ldctoolkit.lanes",
        "ldctoolkit.numba_internals",
        "ldctoolkit.surroundings",
        "ldctoolkit.version",
        "ldctoolkit.checked_files",
    ),
    ("ldctoolkit.declared", "ldctoolkit.validation"),
    ("ldctoolkit.departures", "ldctoolkit.plant_options"),
    ("ldctoolkit.clusters",),
    ("ldctoolkit.recordings",),
    ("ldctoolkit.mixture",),
    ("ldctoolkit.scenarios",),
    ("ldctoolkit.paths",),
    ("ldctoolkit.vehicle",),
    ("ldctoolkit.control", "ldctoolkit.setup"),
    ("ldctoolkit.registry",),
    ("ldctoolkit.law_checks",),
    ("ldctoolkit.metrics",),
    ("ldctoolkit.simulation.kernel",),
    ("ldctoolkit.simulation",),
    # a model is judged by what designs do on its departures
    ("ldctoolkit.scenario_model", "ldctoolkit.models"),
    ("ldctoolkit.diagnostics", "ldctoolkit.identification", "ldctoolkit.other_simulators", "ldctoolkit.review"),
    ("ldctoolkit.testing",),
    ("ldctoolkit",),
    ("ldctoolkit.__main__",),
    ("controllers",),
    ("studies.text", "studies.tables"),
    # the names that a study file's requirements are checked against
    ("studies.standards",),
    ("studies.requirements",),
    ("studies.design", "studies.results"),
    ("studies.study_file", "studies.design_space", "studies.catalog", "studies.vehicle_models"),
    ("studies.study_template",),
    ("studies.storage",),
    ("studies.running",),
    ("studies.assessment", "studies.extraction"),
    ("studies.measures",),
    ("studies.ranking",),
    ("studies.search", "studies.robustness", "studies.step_time"),
    ("studies.runner",),
    ("studies.comparison", "studies.risk", "studies.export", "studies.sensitivity"),
    ("studies.pages",),
    ("studies.plotting",),
    ("studies.cli",),
    ("studies",),
)


def modules(root: Path) -> dict[str, Path]:
    found = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@functools.cache
def parsed(text: str) -> tuple[ast.AST, ...]:
    return (*ast.walk(ast.parse(text)),)


def nodes(path: Path) -> tuple[ast.AST, ...]:
    return parsed(path.read_text(encoding="utf-8"))


def level(module: str) -> int:
    """Level of the longest prefix that is listed; -1 for a room of `studies` that is not."""
    name = module
    while name and not (name == "studies" != module):
        for i, names in enumerate(LEVELS):
            if name in names:
                return i
        name = name.rpartition(".")[0]
    return -1


def imported(path: Path, known: Iterable[str]) -> set[str]:
    """The project's modules that a file imports: wherever in the file, and for the type checker alone too."""
    names: set[str] = set()
    parents = path.relative_to(next(p for p in path.parents if p.name in PACKAGES).parent).parts[:-1]
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = parents[: len(parents) + 1 - node.level] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            base = re.sub(r"^ldctoolkit\.(controllers|studies)\b", r"\1", base)
            names.update(f"{base}.{a.name}" if f"{base}.{a.name}" in known else base for a in node.names)
    return {name for name in names if name.partition(".")[0] in PACKAGES}


def upward_imports(root: Path) -> list[str]:
    """One line for every import of a module that has no level, is not there, or lies higher."""
    found, wrong = modules(root), []
    for module, path in found.items():
        own = level(module)
        if own < 0:
            wrong.append(f"{module} has no level: add it to LEVELS")
        for target in sorted(imported(path, found)):
            # the package ldctoolkit gathers names of its rooms, and of what lies above when they are used
            if module == "ldctoolkit" and target in ("controllers", "studies"):
                continue
            inside = level(target) == own and module != "ldctoolkit"
            if target not in found or not (level(target) < own or inside):
                wrong.append(f"{module} -> {target}")
    return wrong


def below(graph: dict[str, set[str]], start: str) -> set[str]:
    """Everything that is reached from a module or room."""
    reached: set[str] = set()
    open_ends = [start]
    while open_ends:
        new = graph.get(open_ends.pop(), set()) - reached
        reached |= new
        open_ends += new
    return reached


def circles(graph: dict[str, set[str]]) -> set[frozenset[str]]:
    """Sets of modules, or of rooms, that import each other by whatever detour."""
    reached = {name: below(graph, name) for name in graph}
    return {frozenset(other for other in reached[name] if name in reached.get(other, ()))
            for name in graph if name in reached[name]}  # fmt: skip


def file_graph(root: Path) -> dict[str, set[str]]:
    """Imports of files; façades, which gather names of their rooms, aside."""
    found = modules(root)
    files = {module: path for module, path in found.items() if path.name != "__init__.py"}
    return {module: imported(path, found) & {*files} - {module} for module, path in files.items()}


def room_graph(root: Path) -> dict[str, set[str]]:
    """Imports of rooms: the folders of each package, and the files directly in it."""
    rooms: dict[str, set[str]] = {}
    for module, targets in file_graph(root).items():
        room = ".".join(module.split(".")[:2])
        rooms.setdefault(room, set()).update({".".join(target.split(".")[:2]) for target in targets} - {room})
    return rooms


ERRORS = {name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, errors.LdcError)}
SEPARATORS = (": ", "; ", "allowed: ", "; allowed: ")


def sentences_for_data(path: Path) -> list[int]:
    """Lines that take the message of an error apart, or make an error of one sentence that holds its parts."""
    every = nodes(path)
    caught = {node.name for node in every if isinstance(node, ast.ExceptHandler)} | {"error", "problem"}

    def is_error(node: ast.AST) -> bool:
        return isinstance(node, ast.Name) and node.id in caught

    def is_fault(node: ast.AST) -> bool:
        match node:
            case ast.Attribute(value=ast.Call(func=ast.Name(id="str"), args=[given])):  # str(error).partition
                return is_error(given)
            case ast.Subscript(value=ast.Attribute(value=given, attr="args")):  # error.args[0]
                return is_error(given)
            case ast.Call(
                func=ast.Attribute(attr="partition" | "rpartition" | "split" | "removeprefix"), args=[*given]
            ):
                return any(isinstance(one, ast.Constant) and one.value in SEPARATORS for one in given)
            case ast.Call(func=ast.Name(id=name), args=[given], keywords=[]) if name in ERRORS:
                texts = [one.value for one in ast.walk(given) if isinstance(one, ast.Constant)]
                return any(isinstance(text, str) and (": " in text or "; allowed" in text) for text in texts)
        return False

    return [node.lineno for node in every if isinstance(node, ast.expr) and is_fault(node)]


def writes(path: Path) -> bool:
    """Whether a module opens files to write them, or calls what does."""
    calls = [node for node in nodes(path) if isinstance(node, ast.Call)]
    named = [getattr(call.func, "attr", getattr(call.func, "id", "")) for call in calls]
    modes = [
        {arg.value for arg in [*call.args, *(key.value for key in call.keywords)] if isinstance(arg, ast.Constant)}
        for call, name in zip(calls, named, strict=True)
        if name == "open"
    ]
    methods = [call.func.attr for call in calls if isinstance(call.func, ast.Attribute)]
    return bool({*methods} & {"write_text", "write_bytes", "savefig", "tofile"}) or any(
        isinstance(mode, str) and {*mode} & {*"wax"} and {*mode} <= {*"waxbt+"} for found in modes for mode in found
    )


def test_files_are_written_in_one_place() -> None:
    """But for the lock of a folder, the notes of a worker and what a compiler reads, which no one reads afterwards."""
    found = {path.relative_to(ROOT).as_posix() for path in modules(ROOT).values() if writes(path)}
    assert found == {
        "ldctoolkit/checked_files.py", "studies/storage/checked_parts.py", "studies/running/executors.py",
        "ldctoolkit/casadi_code.py",
    }  # fmt: skip


def test_imports_point_down_and_in_no_circles() -> None:
    assert upward_imports(ROOT) == []
    assert circles(file_graph(ROOT)) == circles(room_graph(ROOT)) == set()


def test_contributors_are_told_the_order() -> None:
    """The rooms as `LEVELS` has them, and in the table of files none that imports one to its right."""
    text = (ROOT / "docs/contributing.md").read_text(encoding="utf-8")
    rooms = [level for block in re.findall(r"^```\n([^`]*<[^`]*)```", text, flags=re.M) for level in block.split("<")]
    named = [{name.partition(".")[2] for name in names} - {"", "__main__"} for names in LEVELS]
    assert [set(re.findall(r"[\w.]+", level)) for level in rooms] == [names for names in named if names]
    graph = file_graph(ROOT)
    folders = re.findall(r"^\| `([\w/]+)` \| (.* < .*) \|$", text, flags=re.M)
    assert len(folders) == 8
    for folder, row in folders:
        files = [[f"{folder}/{name}".replace("/", ".") for name in re.findall(r"`(\w+)\.py`", cell)]
                 for cell in row.split("<")]  # fmt: skip
        for lower, higher in itertools.combinations(files, 2):
            assert not set().union(*(graph[name] for name in lower)) & {*higher}, f"{lower} import of {higher}"


def test_the_short_names_are_not_imported() -> None:
    """They may be folders of the user's: relative imports, or the long names."""
    paths = [*modules(ROOT).values(), *(ROOT / "tools").rglob("*.py"), *(ROOT / "tests").rglob("*.py")]
    short = re.compile(r"(^|[\"';])\s*(from|import) (controllers|studies)\b(?!\.?\{)", flags=re.M)
    mine = (Path(__file__), ROOT / "tests/test_shadowing.py")
    assert [path for path in paths if path not in mine and short.search(path.read_text(encoding="utf-8"))] == []


IMPORTS = {
    "at the top": "from studies.{} import thing\n",
    "late": "def f():\n    import studies.{}\n",
    "for the type checker": "if TYPE_CHECKING:\n    from studies.{} import thing\n",
}


@pytest.fixture(params=IMPORTS)
def plant(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[str, str], Path]:
    """A small tree, in which a module of `studies` imports another."""
    for name in ("design", "results", "storage/store", "storage/checked_parts", "ranking/ranking"):
        path = tmp_path / "studies" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")

    def imports(module: str, target: str) -> Path:
        path = tmp_path.joinpath("studies", *module.split(".")).with_suffix(".py")
        path.write_text(path.read_text() + IMPORTS[request.param].format(target))
        return tmp_path

    return imports


def test_planted_faults_are_found(plant: Callable[[str, str], Path]) -> None:
    """Imports that point up, circles of files and of rooms whose files are in none, a room without a level."""
    root = plant("ranking.ranking", "storage.store")
    plant("storage.store", "storage.checked_parts")
    plant("storage.checked_parts", "results")
    assert upward_imports(root) == []
    assert circles(room_graph(root)) == circles(file_graph(root)) == set()
    plant("storage.checked_parts", "ranking.ranking")
    assert upward_imports(root) == ["studies.storage.checked_parts -> studies.ranking.ranking"]
    rooms = frozenset({"studies.storage", "studies.ranking"})
    assert circles(room_graph(root)) == {rooms}
    plant("results", "design")
    plant("design", "results")
    (root / "studies" / "attic.py").write_text("")
    assert upward_imports(root)[0] == "studies.attic has no level: add it to LEVELS"
    assert circles(room_graph(root)) == {rooms, frozenset({"studies.design", "studies.results"})}
    files = {f"studies.{name}" for name in ("storage.store", "storage.checked_parts", "ranking.ranking")}
    assert circles(file_graph(root)) == {frozenset(files), frozenset({"studies.design", "studies.results"})}


def test_a_circle_of_rooms_without_one_of_files_is_found(plant: Callable[[str, str], Path]) -> None:
    root = plant("ranking.ranking", "storage.checked_parts")
    plant("storage.store", "ranking.ranking")
    assert circles(file_graph(root)) == set()
    assert circles(room_graph(root)) == {frozenset({"studies.storage", "studies.ranking"})}


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_loads_nothing_heavy(package: str) -> None:
    """A call of the command line should not wait for a compiler that it does not need."""
    heavy = {"numba", "scipy", "control", "casadi", "polars", "matplotlib", "osqp", "sklearn"}
    name = package if package == "ldctoolkit" else f"ldctoolkit.{package}"
    code = f"import sys, {name}; print(*sorted({heavy} & set(sys.modules)))"
    assert python("-c", code, cwd=ROOT).split() == []


def test_the_zoo_uses_public_names_only() -> None:
    """A law needs nothing that a third party's law could not import from the façade."""
    for module, path in modules(ROOT).items():
        for node in nodes(path):
            if not module.startswith("controllers.") or not isinstance(node, ast.ImportFrom) or node.level:
                continue
            home = node.module or ""
            helpers = "arrays casadi_code checked_files code_content compiling discretization errors law_checks"
            shared = {*helpers.split(), "numba_internals", "surroundings"}
            if home.startswith("ldctoolkit.") and home.rpartition(".")[2] not in shared:
                assert {alias.name for alias in node.names} <= {*ldctoolkit.__all__}, f"{module} imports of {home}"


def imports_the_facade(path: Path) -> bool:
    """Whether a file imports names that ``ldctoolkit/__init__`` gathers for users."""
    return any(
        (isinstance(node, ast.ImportFrom) and node.module == "ldctoolkit" and not node.level)
        or (isinstance(node, ast.Import) and "ldctoolkit" in [alias.name for alias in node.names])
        for node in nodes(path)
    )


@pytest.mark.parametrize("text", ["from ldctoolkit import simulate\n", "def f():\n    import ldctoolkit as ldc\n"])
def test_no_file_imports_from_the_facade(text: str, tmp_path: Path) -> None:
    found = modules(ROOT).items()
    assert [module for module, path in found if module != "ldctoolkit" and imports_the_facade(path)] == []
    (tmp_path / "planted.py").write_text(text)
    assert imports_the_facade(tmp_path / "planted.py")


def test_an_error_is_data() -> None:
    found = {path.relative_to(ROOT).as_posix() for path in modules(ROOT).values() if sentences_for_data(path)}
    assert found == set()


@pytest.mark.parametrize(
    "line",
    [
        "text.partition(': ')", "text.split('; ')", "text.removeprefix('allowed: ')", "str(error).removeprefix(name)",
        "str(e).splitlines()[0]", "str(problem).split()", "error.args[0]", "raise InputError(f'{name}: {value}')",
        "raise LdcError('no law; allowed: lqr')", "raise StudyError('gains: missing') from None",
    ],
)  # fmt: skip
def test_a_planted_sentence_is_found(line: str, tmp_path: Path) -> None:
    path = tmp_path / "planted.py"
    path.write_text(f"try:\n    pass\nexcept ValueError as e:\n    {line}\n")
    assert sentences_for_data(path) == [4]
    path.write_text("raise InputError(name, 'is missing', allowed='a: b')\nstr(value).split()\nname.split('.')\n")
    assert sentences_for_data(path) == []


def test_the_wheel_holds_one_package(tmp_path: Path) -> None:
    """Laid out as the wheel is, it is complete, and nothing beside it is a part of it."""
    wheel = CONFIG["tool"]["hatch"]["build"]["targets"]["wheel"]
    places = {folder: wheel["sources"].get(folder, folder) for folder in wheel["only-include"]}
    assert places == {"ldctoolkit": "ldctoolkit"} | {name: f"ldctoolkit/{name}" for name in PACKAGES[1:]}
    for folder, place in places.items():
        assert (ROOT / folder / "py.typed").is_file()
        left_out = shutil.ignore_patterns("__pycache__", *wheel["exclude"])
        shutil.copytree(ROOT / folder, tmp_path / place, ignore=left_out)
    code = (
        "import ldctoolkit as ldc\nfrom ldctoolkit.controllers.lqr import LQR\n"
        "from ldctoolkit.studies import cli, standards\n"
        "assert LQR is ldc.LQR is ldc.controller_class('lqr'); print(*ldc.__path__)\n"
        "ldc.load_model('reference'); ldc.load_study('paper'); standards.load_standard('iso-11270')\n"
        "raise SystemExit(cli.main(['init', 'paper']))"
    )
    printed = python("-c", code, cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert printed.splitlines()[0] == str(tmp_path / "ldctoolkit")


PROJECT = CONFIG["project"]
REQUIRED = [
    Requirement(text) for text in itertools.chain(PROJECT["dependencies"], *PROJECT["optional-dependencies"].values())
]


def test_what_is_imported_is_declared() -> None:
    known = {one.name.lower().replace("-", "_") for one in REQUIRED} | {*PACKAGES, *sys.stdlib_module_names}
    for module, path in modules(ROOT).items():
        for node in nodes(path):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            outside = {name.partition(".")[0].lower() for name in names} - known - {"pydantic_core", "pandas"}
            assert not outside, f"{module} imports {outside}"


def test_pins_are_plain_and_satisfy_the_bounds() -> None:
    pins = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        name, equals, version = line.partition("==")
        assert equals, f"constraints.txt: {line!r} is not name==version"
        pins[name.lower().replace("_", "-")] = version
    for requirement in REQUIRED:
        assert ">=" in str(requirement.specifier), f"{requirement} has no lower bound"
        assert requirement.specifier.contains(pins[requirement.name.lower()]), requirement


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_outgrows_its_job(package: str) -> None:
    for path in (ROOT / package).rglob("*.py"):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= 700, f"{path.relative_to(ROOT)} has {lines} lines: split it"
