"""The page that compares two studies: one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from studies.comparison.comparison import Comparison

__all__ = ["write_compare_page"]


def write_compare_page(comparison: Comparison, path: str | Path) -> Path:
    """Write a comparison of two studies as one HTML file that needs nothing else.

    Parameters
    ----------
    comparison : Comparison
        As `studies.compare` returns it.
    path : path
        File to write; whole or not at all.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    StoreError
        If it cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from studies import Study, compare, run_study
    >>> content = {"scenarios": {"left": 20, "right": 20}, "design": [{"law": "none"}, {"law": "lqr"}]}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name, m in (("light", 1000.0), ("heavy", 1300.0)):
    ...         study = Study.from_dict(content | {"name": name, "vehicle": {"m": m}})
    ...         _ = run_study(study, directory=f"{folder}/{name}", workers=1)
    ...     page = write_compare_page(compare(f"{folder}/light", f"{folder}/heavy"), f"{folder}/changes.html")
    ...     page.read_text(encoding="utf-8")[:15]
    '<!DOCTYPE html>'
    """
    # templates and plots take a second to import; a command that writes no page should not wait for them
    from studies.compare_page.page import make_page
    from studies.storage.files import write_text

    write_text(Path(path), make_page(comparison))
    return Path(path)
