"""Parts of the reference that the code itself holds: commands, keys of a study file, metrics, gains of the laws.

Each function gives Markdown by file name; `write` puts the files where pages of the reference include them.
"""

import argparse
import ast
import dataclasses
import importlib
import inspect
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import ldctoolkit
from ldctoolkit import Controller, controllers, testing
from ldctoolkit.metrics import GROUPS, METRICS, SCENARIO_METRICS
from ldctoolkit.recordings import departures_table
from ldctoolkit.scenario_model import json_form
from ldctoolkit.studies import study_file
from ldctoolkit.studies.cli import parser
from ldctoolkit.studies.cli.controllers import _interval
from ldctoolkit.studies.design_space import DesignBlock, SampleSettings
from ldctoolkit.studies.storage import manifest
from ldctoolkit.studies.study_template import study_text


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    lines = [tuple(head), ("---",) * len(tuple(head)), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def code(text: object) -> str:
    """Text in a fixed font, empty for nothing."""
    return f"`{text}`" if str(text) else ""


def commands() -> Iterator[tuple[str, str]]:
    """Every command: what it does, how it is called, its arguments and options."""
    (sub,) = (one for one in parser()._actions if isinstance(one, argparse._SubParsersAction))
    rows = ((f"[`ldc {one.dest}`](#ldc-{one.dest})", one.help or "") for one in sub._choices_actions)
    yield "commands.md", table(("command", "what it does"), rows)
    for name, one in sub.choices.items():
        usage = re.sub(r"\s+", " ", one.format_usage().removeprefix("usage: "))
        formatter = one._get_formatter()
        rows = (
            (code(formatter._format_action_invocation(action)), formatter._expand_help(action))
            for action in one._actions
            if action.dest != "help"
        )
        body = table(("argument or option", "meaning"), rows)
        yield f"ldc-{name}.md", f"{one.description}\n\n```text\n{usage.strip()}\n```\n\n{body}"


def comments(owner: type) -> dict[str, str]:
    """What the comments above and beside the fields of a class say."""
    lines = inspect.getsource(owner).splitlines()
    found = {}
    for node in ast.parse("\n".join(lines)).body[0].body:  # type: ignore[attr-defined]
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            above = node.lineno - 1
            while lines[above - 1].strip().startswith("#"):
                above -= 1
            end = lines[node.end_lineno - 1][node.end_col_offset :]  # type: ignore[operator]
            texts = [line.strip().lstrip("#") for line in (*lines[above : node.lineno - 1], end)]
            text = " ".join(" ".join(texts).split()).replace("``", "`")
            found[node.target.id] = text or "the same"
    return found


def study_keys() -> Iterator[tuple[str, str]]:
    """Every key of a study file: what `ldc init` writes, and the keys of a design from the models that read it."""
    study = study_file.Study.from_dict({"name": "x", "design": [{"law": "none"}]})
    rows, part = [], ""
    for line in study_text(study).partition("[[design]]")[0].splitlines():
        if head := re.match(r"(?:# )?\[([\w.]+)\]  # (.*)", line):
            part = f"{head[1]}."
            about = head[2].replace("for a key of it, uncomment this line too", "absent by default")
            rows.append((f"**`[{head[1]}]`**", "", about))
        elif key := re.match(r"(?:# )?(\w+) = .*?  # (.*)", line):
            text, _, default = key[2].rpartition("; default ")
            rows.append((code(part + key[1]), code(default) if text else "needed", text or key[2]))
    rows.append(("**`[[design]]`**", "", "designs that are compared; a grid of the values that are set"))
    for model, part in ((DesignBlock, "design."), (SampleSettings, "design.sample.")):
        rows += [(code(part + name), "", text) for name, text in comments(model).items() if name[0] != "_"]
    yield "study-keys.md", table(("key", "default", "meaning; allowed"), rows)


def metrics() -> Iterator[tuple[str, str]]:
    """Metrics of a scenario and of a design."""
    rows = (
        (code(name), one.title, one.unit, one.better, one.over, "" if math.isnan(one.limit) else f"{one.limit:g}")
        for name, one in SCENARIO_METRICS.items()
    )
    yield "scenario-metrics.md", table(("metric", "title", "unit", "better", "over", "limit"), rows)
    text = ""
    for group, title in GROUPS.items():
        rows = (
            (code(one.name), one.title, one.unit, one.better, code(one.column), ", ".join(map(code, one.aliases)))
            for one in METRICS.values()
            if one.group == group
        )
        text += f"**{title}**\n\n" + table(("metric", "title", "unit", "better", "column", "other names"), rows) + "\n"
    yield "design-metrics.md", text


def laws() -> Iterator[tuple[str, str]]:
    """The declared gains of every law of the toolkit."""
    for name in controllers.__all__:
        kind = getattr(controllers, name)
        if not dataclasses.is_dataclass(kind) or not issubclass(kind, Controller):
            continue
        rows = []
        for g in kind.gains():
            words = ("true", "false") if isinstance(g.default, bool) else g.choices
            allowed = ", ".join(map(code, words)) if words else "any text" if g.text else _interval(g.lower, g.upper)
            default = str(g.default).lower() if isinstance(g.default, bool) else str(g.default)
            rows.append((code(g.name), "" if g.unit == "1" else g.unit, code(default), allowed, g.description))
        body = table(("gain", "unit", "default", "allowed", "meaning"), rows) if rows else "It has no gains.\n"
        yield f"law-{kind.name}.md", f"`{kind.__name__}`: {kind.title}.\n\n{body}"


GUIDES = Path(__file__).parents[1] / "how-to"


def names_of_guides() -> list[tuple[str, str]]:
    """Module and name of what the how-to guides import from modules of the toolkit, or name there."""
    found = set()
    for page in GUIDES.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for module, names in re.findall(r"^from (ldctoolkit\.[\w.]+) import (.+)$", text, flags=re.M):
            found |= {(module, name.strip()) for name in names.split(",")}
        found |= set(re.findall(r"`(ldctoolkit(?:\.[a-z_]+)+)\.([A-Z]\w+)\b", text))
    return sorted(found)


def promises() -> Iterator[tuple[str, str]]:
    """What `reference/stability.md` lists: further public modules, and the formats of files with their versions."""
    modules: dict[str, list[str]] = {"ldctoolkit.testing": list(testing.__all__)}
    for module, name in names_of_guides():
        thing = getattr(importlib.import_module(module), name)
        if thing is not getattr(ldctoolkit, name, None) and name not in modules.setdefault(module, []):
            modules[module].append(name)
    rows = ((code(module), ", ".join(map(code, names))) for module, names in modules.items() if names)
    yield "public-modules.md", table(("module", "public names"), rows)
    formats = (
        ("result folder of `ldc run`", "`manifest.json`, `format_version`", (manifest.FORMAT_VERSION,)),
        ("scenario model of `ldc fit`", "the JSON file, `version`", json_form._READABLE),
        ("departures table of `ldc extract`", "metadata `ldctoolkit.departures` of the Parquet file, `format_version`",
         (departures_table.FORMAT_VERSION,)),
    )  # fmt: skip
    rows = ((what, where, str(reads[-1]), ", ".join(map(str, reads))) for what, where, reads in formats)
    yield "formats.md", table(("what", "where its version stands", "written", "read"), rows)


def write(folder: Path) -> None:
    """Write what changed."""
    folder.mkdir(exist_ok=True)
    for part in (commands, study_keys, metrics, laws, promises):
        for name, text in part():
            path = folder / name
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")
