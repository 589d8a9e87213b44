"""The page that tells what an extraction kept and why: one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ldctoolkit.recordings import Extraction

__all__ = ["write_extraction_page"]


def write_extraction_page(path: str | Path, extraction: Extraction) -> Path:
    """Write what was found in recordings, and what was refused, as one HTML file that needs nothing else.

    Parameters
    ----------
    path : path
        File to write; whole or not at all.
    extraction : Extraction
        As `ldctoolkit.extract_departures` or ``ldc extract`` makes it.

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
    >>> import numpy as np
    >>> from ldctoolkit.recordings import Recording, extract_departures
    >>> t = np.arange(0, 10, 0.1)
    >>> beyond = np.clip(0.3 - 0.3 * (t - 5) ** 2, -0.5, None)
    >>> one = np.ones(t.size)
    >>> drive = Recording("a", t, beyond + 0.85, 3.6 * one, 25.0 * one, one > 0, curvature=0.0 * one)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     page = write_extraction_page(f"{folder}/quality.html", extract_departures([drive]))
    ...     page.read_text(encoding="utf-8")[:15]
    '<!DOCTYPE html>'
    """
    # templates take a while to import; a command that writes no page should not wait for them
    from studies.extraction_page.page import make_page
    from studies.storage.files import write_text

    write_text(Path(path), make_page(extraction))
    return Path(path)
