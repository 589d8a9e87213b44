"""Stored files as they are changed on purpose, or damaged."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ldctoolkit.checked_files import json_text


def rewrite_json(path: Path, change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """Change a JSON file in place, with the checksum of what it holds then; what it holds."""
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    del content["checksum"]
    change(content)
    path.write_text(json_text(content), encoding="utf-8")
    return content
