"""What is public, as `docs/reference/stability.md` says it: names, arguments, options, keys, gains, metrics.

    python tools/public_surface.py

writes it to tests/data/public_MAJOR_MINOR.json, and refuses where something of the last such file is gone that no
deprecation announced. Each entry of the file is a kind, an owner, and what it has, as words.
"""

from __future__ import annotations

import argparse
import enum
import importlib
import inspect
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "tests" / "data"
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import generated  # noqa: E402

import ldctoolkit  # noqa: E402
from ldctoolkit import controllers, errors  # noqa: E402
from ldctoolkit.deprecation import Deprecation  # noqa: E402
from ldctoolkit.metrics import METRICS, SCENARIO_METRICS  # noqa: E402
from ldctoolkit.studies.cli import parser  # noqa: E402
from ldctoolkit.studies.requirements import SETS  # noqa: E402
from ldctoolkit.studies.standards import standard_names  # noqa: E402
from ldctoolkit.studies.study_file import FORMER_KEYS, catalog_names  # noqa: E402

PACKAGES = ("ldctoolkit", "ldctoolkit.studies", "ldctoolkit.testing")
"""All names of their ``__all__`` are public."""

PYDANTIC = ("model_config", "model_fields", "model_computed_fields", "model_post_init")

Entry = tuple[str, str, str, Deprecation | None]  # kind, owner, word, and its deprecation


def public_names() -> dict[str, Any]:
    """Everything that is public in Python, by its full name."""
    pairs = [(package, name) for package in PACKAGES for name in importlib.import_module(package).__all__]
    pairs += [("ldctoolkit.errors", name) for name, one in vars(errors).items()
              if isinstance(one, type) and issubclass(one, errors.LdcError)]  # fmt: skip
    found = {}
    for module, name in [*pairs, *generated.names_of_guides()]:
        thing = getattr(importlib.import_module(module), name)
        if module == "ldctoolkit" or thing is not getattr(ldctoolkit, name, None):
            found[f"{module}.{name}"] = thing
    return found


def members(kind: type) -> dict[str, Any]:
    """Public attributes of a class that the toolkit itself defines."""
    found: dict[str, Any] = {}
    for owner in reversed(kind.__mro__):
        if owner.__module__.startswith("ldctoolkit"):
            found |= dict.fromkeys(inspect.get_annotations(owner)) | dict(vars(owner))
    return {name: found[name] for name in sorted(found) if not name.startswith("_") and name not in PYDANTIC}


def arguments(owner: str, thing: Any) -> Iterator[Entry]:
    """The arguments of a function, or of a class; ``*`` stands before those that are given by name alone."""
    parameters, by_name = list(inspect.signature(thing).parameters.values()), False
    for one in parameters:
        if one.kind in (one.KEYWORD_ONLY, one.VAR_POSITIONAL) and not by_name:
            by_name = True
            yield "arguments", owner, "*", None
        if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD) and one.name not in ("self", "cls"):
            yield "arguments", owner, one.name, one.default if isinstance(one.default, Deprecation) else None


def of_python() -> Iterator[Entry]:
    for name, thing in public_names().items():
        module, _, short = name.rpartition(".")
        yield "names", module, short, vars(thing).get("__deprecated__") if hasattr(thing, "__dict__") else None
        if callable(thing) and not (isinstance(thing, type) and issubclass(thing, (enum.Enum, Exception))):
            yield from arguments(name, thing)
        for member, value in members(thing).items() if isinstance(thing, type) else ():
            function = getattr(value, "fget", None) or getattr(value, "__func__", value)
            yield "members", name, member, getattr(function, "__deprecated__", None)
            if inspect.isfunction(getattr(value, "__func__", value)):
                yield from arguments(f"{name}.{member}", function)


def of_commands() -> Iterator[Entry]:
    top = parser()
    (sub,) = (one for one in top._actions if isinstance(one, argparse._SubParsersAction))
    for name, command in {"ldc": top, **{f"ldc {name}": one for name, one in sub.choices.items()}}.items():
        given = [action for action in command._actions if action is not sub and action.dest != "help"]
        by_place = [action for action in given if not action.option_strings]
        for action in given:
            deprecation = getattr(action, "__deprecated__", None)
            for word in action.option_strings or [f"<{by_place.index(action) + 1}>"]:
                yield "options", name, word, deprecation
                for choice in action.choices or ():
                    yield "choices", f"{name} {word}", str(choice), deprecation
        yield "options", name, "--help", None


def of_files() -> Iterator[Entry]:
    (_, keys), *_ = generated.study_keys()
    for key in re.findall(r"^\| `([\w.]+)` ", keys, flags=re.M):
        table, _, name = key.rpartition(".")
        yield "keys", table, name, None
    for old, deprecation in FORMER_KEYS.items():
        table, _, name = old.rpartition(".")
        yield "keys", table, name, deprecation
    for name in controllers.__all__:
        kind = getattr(controllers, name)
        for gain in kind.gains() if hasattr(kind, "gains") and getattr(kind, "name", "") else ():
            yield "gains", kind.name, gain.name, None
    for name in SCENARIO_METRICS:
        yield "metrics", "of a scenario", name, None
    for metric in METRICS.values():
        for name in (metric.name, metric.column, *metric.aliases):
            yield "metrics", "of a design", name, None
    for title, names in (("requirement set", SETS), ("test", standard_names()), ("study", catalog_names()),
                         ("model", ldctoolkit.bundled_models())):  # fmt: skip
        for name in names:
            yield "catalog", title, name, None
    for group, points in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"].items():
        yield from (("entry points", group, name, None) for name in points)


def surface() -> dict[str, Any]:
    """What is public now; what of it is deprecated has since when and in which version it is removed."""
    public: dict[str, dict[str, str]] = {}
    deprecated = {}
    for make in (of_python, of_commands, of_files):
        for kind, owner, word, deprecation in make():
            words = public.setdefault(kind, {}).setdefault(owner, "")
            if word not in words.split() or word == "*":
                public[kind][owner] = f"{words} {word}".strip()
            if deprecation is not None:
                deprecated[f"{kind}: {owner}: {word}"] = [deprecation.since, deprecation.removed_in]
    return {"version": ldctoolkit.__version__, "deprecated": deprecated, "public": public}


def number(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")[:2]))


def broken(pinned: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """What of an earlier surface is gone, or in another place, without a deprecation that announced it in time."""
    faults = []
    for kind, owners in pinned["public"].items():
        for owner, text in owners.items():
            words, present = text.split(), now["public"].get(kind, {}).get(owner, "").split()
            for place, word in enumerate(words):
                name = f"{kind}: {owner}: {word}"
                _, removed_in = pinned["deprecated"].get(name, ("", ""))
                if word not in present and word != "*":
                    if not removed_in or number(now["version"]) < number(removed_in):
                        faults.append(f"{name} is gone")
                elif kind == "arguments" and name not in now["deprecated"] and not is_class(owner):
                    by_position = place < (words.index("*") if "*" in words else len(words))
                    if by_position and present[place : place + 1] != [word]:
                        faults.append(f"{name} is no longer argument {place + 1}")
    for name, (since, removed_in) in now["deprecated"].items():
        if number(removed_in) <= number(since):
            faults.append(f"{name} goes in {removed_in}, with no minor version since {since}")
        if number(now["version"]) >= number(removed_in):
            faults.append(f"{name} was to be removed in {removed_in}")
    return faults


def is_class(owner: str) -> bool:
    """Whether the arguments are those of a class, which are given by name."""
    return owner.rpartition(".")[2][:1].isupper()


def last() -> Path:
    """The file of the last release that has one."""
    return max(DATA.glob("public_*.json"), key=lambda path: tuple(map(int, path.stem.split("_")[1:])))


def main() -> int:
    now = surface()
    if any(DATA.glob("public_*.json")) and (faults := broken(json.loads(last().read_text(encoding="utf-8")), now)):
        print("\n".join(faults), file=sys.stderr)
        return 1
    path = DATA / "public_{}_{}.json".format(*number(now["version"]))
    path.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    print(path.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
