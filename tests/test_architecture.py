"""The shape of the house: imports point down, the wheel names its packages, no circles, no module outgrows its job."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

import ldctoolkit

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("ldctoolkit", "controllers", "studies")

# bottom to top: a module may import from below, and from its own level
LEVELS = (
    (
        "ldctoolkit.arrays",
        "ldctoolkit.code_content",
        "ldctoolkit.compiling",
        "ldctoolkit.errors",
        "ldctoolkit.frames",
        "ldctoolkit.lane_functions",
        "ldctoolkit.package_names",
        "ldctoolkit.surroundings",
        "ldctoolkit.version",
        "ldctoolkit.whole_file",
    ),
    ("ldctoolkit.option_checks", "ldctoolkit.validation"),
    ("ldctoolkit.departures", "ldctoolkit.plant_options"),
    ("ldctoolkit.recordings",),
    ("ldctoolkit.mixture",),
    ("ldctoolkit.scenarios",),
    ("ldctoolkit.paths",),
    ("ldctoolkit.gains", "ldctoolkit.vehicle"),
    ("ldctoolkit.control", "ldctoolkit.setup"),
    ("ldctoolkit.registry",),
    ("ldctoolkit.law_checks", "ldctoolkit.notebook"),
    ("ldctoolkit.metrics",),
    ("ldctoolkit.simulation.kernel",),
    ("ldctoolkit.simulation",),
    # a model is judged by what designs do on its departures
    ("ldctoolkit.scenario_model", "ldctoolkit.models"),
    ("ldctoolkit.diagnostics",),
    ("ldctoolkit.departure_plot",),
    ("ldctoolkit",),
    ("ldctoolkit.__main__",),
    ("controllers",),
    # the names that a study file's requirements are checked against
    ("studies.standards",),
    ("studies.requirements",),
    ("studies.design", "studies.results"),
    ("studies.study_file", "studies.design_space", "studies.plant_table"),
    ("studies.study_template",),
    ("studies.replayed",),
    ("studies.storage",),
    ("studies.running",),
    ("studies.assessment", "studies.extraction"),
    ("studies.measures",),
    ("studies.ranking",),
    ("studies.racing", "studies.search", "studies.robustness"),
    ("studies.runner", "studies.compile_loops"),
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
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
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


def circles(root: Path) -> list[str]:
    """Circles of files, the first found from each file on."""
    found = modules(root)
    graph = {module: imported(path, found) for module, path in found.items()}
    graph["ldctoolkit"] = graph.get("ldctoolkit", set()) - {"controllers", "studies"}  # loaded when they are used
    done: set[str] = set()
    wrong: list[str] = []

    def visit(module: str, trail: tuple[str, ...]) -> None:
        if module in trail:
            wrong.append(" -> ".join([*trail[trail.index(module) :], module]))
        if module in done or module in trail:
            return
        for target in sorted(graph.get(module, ())):
            # a package's __init__ gathers its modules; importing a sibling through the full name is no circle
            if not module.startswith(f"{target}."):
                visit(target, (*trail, module))
        done.add(module)

    for module in graph:
        visit(module, ())
    return wrong


def writes(path: Path) -> bool:
    """Whether a module opens files to write them, or calls what does."""
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
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
        "ldctoolkit/whole_file.py", "studies/storage/files.py", "studies/running/executors/processes.py",
        "controllers/_nmpc_solver.py",
    }  # fmt: skip


def test_imports_point_down() -> None:
    assert upward_imports(ROOT) == []


def test_the_short_names_are_not_imported() -> None:
    """They may be folders of the user's: relative imports, or the long names."""
    for module, path in modules(ROOT).items():
        text = path.read_text(encoding="utf-8")
        if module == "ldctoolkit":  # for type checkers alone
            text = text.partition("if TYPE_CHECKING")[0]
        assert not re.search(r"^\s*(from|import) (controllers|studies)\b", text, flags=re.M), module


def test_no_circles_of_files() -> None:
    assert circles(ROOT) == []


IMPORTS = {
    "at the top": "from studies.{} import thing\n",
    "late": "def f():\n    import studies.{}\n",
    "for the type checker": "if TYPE_CHECKING:\n    from studies.{} import thing\n",
}


@pytest.fixture(params=IMPORTS)
def plant(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[str, str], Path]:
    """A small tree, in which a module of `studies` imports another."""
    for name in ("design", "results", "storage/store", "storage/parts", "ranking/ranking"):
        path = tmp_path / "studies" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")

    def imports(module: str, target: str) -> Path:
        path = tmp_path.joinpath("studies", *module.split(".")).with_suffix(".py")
        path.write_text(path.read_text() + IMPORTS[request.param].format(target))
        return tmp_path

    return imports


def test_a_planted_upward_import_is_found(plant: Callable[[str, str], Path]) -> None:
    root = plant("ranking.ranking", "storage.store")
    assert upward_imports(root) == []
    plant("storage.store", "ranking.ranking")
    assert upward_imports(root) == ["studies.storage.store -> studies.ranking.ranking"]
    assert circles(root) == ["studies.ranking.ranking -> studies.storage.store -> studies.ranking.ranking"]


def test_a_planted_circle_is_found(plant: Callable[[str, str], Path]) -> None:
    root = plant("storage.store", "storage.parts")
    plant("storage.parts", "results")
    assert circles(root) == []
    plant("results", "design")
    plant("design", "results")
    assert upward_imports(root) == []
    assert circles(root) == ["studies.design -> studies.results -> studies.design"]


def test_a_room_without_a_level_is_found(plant: Callable[[str, str], Path]) -> None:
    root = plant("design", "results")
    (root / "studies" / "attic.py").write_text("")
    assert upward_imports(root) == ["studies.attic has no level: add it to LEVELS"]


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_loads_nothing_heavy(package: str) -> None:
    """A call of the command line should not wait for a compiler that it does not need."""
    heavy = {"numba", "scipy", "control", "casadi", "polars", "matplotlib", "osqp", "sklearn"}
    code = f"import sys, {package}; print(*sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_the_zoo_uses_public_names_only() -> None:
    """A law needs nothing that a third party's law could not import from the façade."""
    for module, path in modules(ROOT).items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not module.startswith("controllers.") or not isinstance(node, ast.ImportFrom) or node.level:
                continue
            home = node.module or ""
            if home.startswith("ldctoolkit.") and home.rpartition(".")[2] not in ("arrays", "errors", "surroundings"):
                assert {alias.name for alias in node.names} <= {*ldctoolkit.__all__}, f"{module} imports of {home}"


def imports_the_facade(path: Path) -> bool:
    """Whether a file imports names that ``ldctoolkit/__init__`` gathers for users."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module == "ldctoolkit" and not node.level:
            return True
        if isinstance(node, ast.Import) and any(alias.name == "ldctoolkit" for alias in node.names):
            return True
    return False


def test_no_file_imports_from_the_facade(tmp_path: Path) -> None:
    found = modules(ROOT)
    assert [
        module for module, path in found.items() if module not in ("ldctoolkit", "studies") and imports_the_facade(path)
    ] == []
    for text in ("from ldctoolkit import simulate\n", "def f():\n    import ldctoolkit as ldc\n"):
        (tmp_path / "planted.py").write_text(text)
        assert imports_the_facade(tmp_path / "planted.py")


def test_the_wheel_lists_its_packages_by_name() -> None:
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert config["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == list(PACKAGES)
    for package in PACKAGES:
        assert (ROOT / package / "py.typed").is_file()


def test_what_is_imported_is_declared() -> None:
    from packaging.requirements import Requirement

    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    listed = [*config["dependencies"], *(one for extra in config["optional-dependencies"].values() for one in extra)]
    known = {Requirement(one).name.lower().replace("-", "_") for one in listed} | {*PACKAGES, *sys.stdlib_module_names}
    for module, path in modules(ROOT).items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            outside = {name.partition(".")[0].lower() for name in names} - known - {"pydantic_core", "pandas"}
            assert not outside, f"{module} imports {outside}"


def test_pins_are_plain_and_satisfy_the_bounds() -> None:
    from packaging.requirements import Requirement

    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        name, equals, version = line.partition("==")
        assert equals, f"constraints.txt: {line!r} is not name==version"
        pins[name.lower().replace("_", "-")] = version
    wanted = [*config["dependencies"], *(r for extra in config["optional-dependencies"].values() for r in extra)]
    for requirement in map(Requirement, wanted):
        assert ">=" in str(requirement.specifier), f"{requirement} has no lower bound"
        assert requirement.specifier.contains(pins[requirement.name.lower()]), requirement


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_outgrows_its_job(package: str) -> None:
    for path in (ROOT / package).rglob("*.py"):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= 700, f"{path.relative_to(ROOT)} has {lines} lines: split it"
