"""Words that stand for a missing number in tables of text."""

from __future__ import annotations

from typing import Final

MISSING: Final = ("", "null", "nan", "na", "n/a", "none", "-nan", "#n/a")
"""In lower case, without blanks around them."""
