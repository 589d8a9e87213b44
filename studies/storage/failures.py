"""``failures.json``: designs whose law failed, each with its sentence; they are tried again by the next run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from ldctoolkit.errors import StoreError
from studies.results import RunKey
from studies.storage.files import write_text

FAILURES = "failures.json"


def read_failures(folder: Path) -> dict[RunKey, str]:
    """Why runs failed, of those that did; none where the file is missing.

    Raises
    ------
    StoreError
        If the file is broken.
    """
    path = folder / FAILURES
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        found = {
            (design, convention): sentence
            for design, sentences in content["designs"].items()
            for convention, sentence in sentences.items()
        }
        if not all(isinstance(sentence, str) for sentence in found.values()):
            raise TypeError(found)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise StoreError(f"{path}: broken; it holds which designs failed, and why") from None
    return found


def write_failures(folder: Path, failures: Mapping[RunKey, str]) -> None:
    """Write or replace the failures of a folder, sorted by design and convention; no file where there are none."""
    path = folder / FAILURES
    designs: dict[str, dict[str, str]] = {}
    for (design, convention), sentence in sorted(failures.items()):
        designs.setdefault(design, {})[convention] = sentence
    if designs:
        write_text(path, json.dumps({"designs": designs}, indent=1) + "\n")
    else:
        path.unlink(missing_ok=True)
