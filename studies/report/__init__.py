"""The comparison report: one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path

from studies.report.inputs import ReportInput

__all__ = ["ReportInput", "write_report"]


def write_report(report_input: ReportInput, path: str | Path) -> Path:
    """Write the report of a study as one HTML file that needs nothing else.

    Parameters
    ----------
    report_input : ReportInput
        Results, rankings and what is to be told about them.
    path : path
        File to write; whole or not at all.

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
    from studies.report.page import write_page

    return write_page(report_input, Path(path))
