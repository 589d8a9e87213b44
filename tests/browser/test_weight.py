"""A page of 1,000 designs is light, and the same study gives the same bytes in another process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def test_a_thousand_designs_weigh_less_than_3_MB(made: Any) -> None:
    page: Path = made("thousand").path
    assert page.stat().st_size < 3_000_000
    assert page.stat().st_size > 400_000  # all of them are in it


def test_same_bytes_whatever_the_hash_salt(made: Any) -> None:
    folder: Path = made("ordinary").folder
    pages = []
    for salt in ("1", "2"):
        environment = os.environ | {"PYTHONHASHSEED": salt, "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "ldctoolkit", "report", str(folder), "--no-figures"]
        subprocess.run(command, env=environment, check=True, capture_output=True, timeout=300)
        pages.append((folder / "report.html").read_bytes())
    assert pages[0] == pages[1]
