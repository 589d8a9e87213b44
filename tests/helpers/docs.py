"""Code that README and guides show, to be run as it stands."""

import re
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def blocks(page: str, language: str) -> list[str]:
    """The blocks of a page in one language, by its path in the project: ``"docs/cli.md"``."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), flags=re.S)


def run_python(page: str, scope: dict[str, Any]) -> dict[str, Any]:
    """Run all Python of a page, one block after the other in one scope; the scope."""
    for code in blocks(page, "python"):
        exec(compile(code, page, "exec"), scope)
    return scope


def install(project: Path, site: Path) -> None:
    """Leave in a folder what pip leaves of a pure package there, without a build backend or a network."""
    declared = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    name, version = declared["name"].replace("-", "_"), declared["version"]
    info = site / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {declared['name']}\nVersion: {version}\n")
    groups = (
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in declared["entry-points"].items()
    )
    (info / "entry_points.txt").write_text("\n".join(groups))
    (site / name).symlink_to(project / name, target_is_directory=True)
