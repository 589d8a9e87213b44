"""What failed, and how the study was run: settings, versions, the command and the file that make it again."""

from collections.abc import Sequence

from markupsafe import Markup

from ..text import plural, printable, symbols
from .context import Context
from .explorer import failures
from .shell import Section, bullets, details

MOST_FAILED = 50


def section(context: Context) -> Section:
    """The section."""
    report, failed = context.report, context.report.results.failed
    body = failures(context)
    if failed:
        listed = [one.sentence for one in failed[:MOST_FAILED]]
        if len(failed) > MOST_FAILED:
            listed.append(f"and {len(failed) - MOST_FAILED} more, see ranking.csv")
        body += Markup("<p>{} failed and {} not ranked:</p>{}").format(
            plural(len(failed), "design"), "is" if len(failed) == 1 else "are", bullets(listed)
        )
    facts = [*report.settings, *report.versions]
    body += details("All settings, versions and the machine", pairs(facts))
    if report.command:
        body += Markup("<p>The study again: <code>{}</code></p>").format(printable(report.command))
    if report.study_file:
        body += details(
            "The study file with every default", Markup("<pre>{}</pre>").format(printable(report.study_file))
        )
    return Section("settings", "Failures and settings", body)


def pairs(facts: Sequence[tuple[str, str]]) -> Markup:
    """Names and values as a list."""
    items = Markup("").join(Markup("<dt>{}</dt><dd>{}</dd>").format(symbols(a), symbols(b)) for a, b in facts)
    return Markup("<dl>{}</dl>").format(items)
