"""The report's figures as files for papers and slides: SVG and PNG."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from studies.report.look.style import figure_settings
from studies.report.section import Drawing
from studies.storage.files import stored_file, write_text

DPI: Final = 300
"""What journals ask of a figure with lines and text."""


def write_figures(drawings: Iterable[Drawing], folder: Path) -> tuple[Path, ...]:
    """Write every figure as ``NAME.svg`` and ``NAME.png``; figures of an earlier report go.

    Parameters
    ----------
    drawings : iterable of Drawing
    folder : Path
        Made if need be. Files in it that are neither SVG nor PNG are left alone.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    OSError
        If one cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for drawing in drawings:
        path = folder / f"{drawing.name}.svg"
        write_text(path, drawing.document)
        picture = io.BytesIO()
        with figure_settings():
            drawing.figure.savefig(picture, format="png", dpi=DPI, metadata={"Software": None})
        with stored_file(path.with_suffix(".png")) as stream:
            stream.write(picture.getvalue())
        written += [path, path.with_suffix(".png")]
    for old in sorted(folder.iterdir()):
        if old.suffix in (".svg", ".png") and old not in written:
            old.unlink()
    return tuple(written)
