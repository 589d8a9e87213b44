"""Settings: study file, versions, seeds, hashes, machine, and the command that makes it again."""

from __future__ import annotations

from studies.report.context import Context
from studies.report.rendering import render
from studies.report.section import Section


def section(context: Context) -> Section:
    """The section."""
    return Section("settings", "Settings", render("sections/settings.html", report=context.report))
