"""The comparison report: one self-contained HTML file, and its figures for papers."""

from __future__ import annotations

from pathlib import Path

from studies.report.inputs import ReportInput

__all__ = ["ReportInput", "write_report"]


def write_report(report_input: ReportInput, path: str | Path, *, figures: str | Path | None = None) -> Path:
    """Write the report of a study as one HTML file that needs nothing else.

    Parameters
    ----------
    report_input : ReportInput
        Results, rankings and what is to be told about them.
    path : path
        File to write; whole or not at all.
    figures : path, optional
        Folder for the figures, as SVG and as PNG of 300 dots an inch; none are written without it.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If there is nothing to report on.
    """
    # templates and plots take a second to import; a command that writes no report should not wait for them
    from studies.report.figure_files import write_figures
    from studies.report.page import make_page
    from studies.storage.files import write_text

    page = make_page(report_input)
    write_text(Path(path), page.html)
    if figures is not None:
        write_figures(page.drawings, Path(figures))
    return Path(path)
