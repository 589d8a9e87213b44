"""The shape of the house: imports point down, the wheel names its packages, no module outgrows its job."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("ldctoolkit", "controllers", "studies")

# bottom to top: a module may import from below, and from its own room
LEVELS = (
    ("ldctoolkit.errors", "ldctoolkit.version", "ldctoolkit.whole_file"),
    ("ldctoolkit.option_checks",),
    ("ldctoolkit.departure_columns",),
    ("ldctoolkit.departures", "ldctoolkit.plant_options"),
    ("ldctoolkit.recordings",),
    ("ldctoolkit.mixture",),
    ("ldctoolkit.scenarios",),
    ("ldctoolkit.scenario_model", "ldctoolkit.models"),
    ("ldctoolkit.diagnostics",),
    ("ldctoolkit.gains", "ldctoolkit.vehicle"),
    ("ldctoolkit.control",),
    ("ldctoolkit.registry",),
    ("ldctoolkit.law_checks",),
    ("ldctoolkit.metrics",),
    (
        "ldctoolkit.simulation._philox",
        "ldctoolkit.simulation._residual_kernels",
        "ldctoolkit.simulation.random_streams",
    ),
    ("ldctoolkit.simulation.kernel",),
    ("ldctoolkit.simulation",),
    ("ldctoolkit",),
    ("ldctoolkit.launcher", "ldctoolkit.__main__"),
    ("controllers",),
    ("studies",),
)


def modules() -> dict[str, Path]:
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def level(module: str) -> int:
    """Level of the longest prefix that is listed."""
    best, name = -1, module
    while name:
        for i, names in enumerate(LEVELS):
            if name in names and best < 0:
                best = i
        if best >= 0:
            break
        name = name.rpartition(".")[0]
    return best


def imported(path: Path, known: set[str], *, typing: bool = True) -> set[str]:
    """The project's modules that a file imports, wherever in the file; for the type checker alone only on request."""
    names: set[str] = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    unseen = {id(node) for block in ast.walk(tree) if _for_typing(block) for node in ast.walk(block)}
    for node in ast.walk(tree):
        if not typing and id(node) in unseen:
            continue
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            base = node.module or ""
            names.update(f"{base}.{a.name}" if f"{base}.{a.name}" in known else base for a in node.names)
    return {name for name in names if name.partition(".")[0] in PACKAGES}


def _for_typing(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def test_imports_point_down() -> None:
    found = modules()
    for module, path in found.items():
        own = level(module)
        assert own >= 0, f"{module} has no level: add it to LEVELS"
        for target in imported(path, set(found)):
            assert target in found, f"{module} imports {target}, which does not exist"
            # inside one room modules may use each other; the test below refuses circles
            inside = level(target) == own and module != "ldctoolkit"
            assert level(target) < own or inside, f"{module} imports {target}: upwards"


def test_no_circular_imports() -> None:
    """None at run time, however late the import."""
    found = modules()
    graph = {module: imported(path, set(found), typing=False) for module, path in found.items()}
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " -> ".join([*trail, module])
        if module in done:
            return
        for target in graph.get(module, ()):
            # a package's __init__ gathers its modules; importing a sibling through the full name is no circle
            if not module.startswith(f"{target}."):
                visit(target, (*trail, module))
        done.add(module)

    for module in graph:
        visit(module, ())


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_loads_nothing_heavy(package: str) -> None:
    """A call of the command line should not wait for a compiler that it does not need."""
    heavy = {"numba", "scipy", "control", "casadi", "polars", "matplotlib", "osqp", "sklearn"}
    code = f"import sys, {package}; print(*sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_the_zoo_uses_public_names_only() -> None:
    """A law needs nothing that a third party's law could not import."""
    public = {"ldctoolkit", "ldctoolkit.errors"}
    for module, path in modules().items():
        if module.startswith("controllers"):
            outside = {t for t in imported(path, set(modules())) if t.startswith("ldctoolkit")}
            assert outside <= public, f"{module} imports {outside - public}"


def test_the_wheel_lists_its_packages_by_name() -> None:
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert config["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == list(PACKAGES)
    for package in PACKAGES:
        assert (ROOT / package / "py.typed").is_file()


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
