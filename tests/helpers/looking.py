"""What a reader's eye would see, and what axe-core's rules say, as lists of faults."""

from pathlib import Path
from typing import Any

_LAYOUT = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")

_RULES = """() => axe.run(document, { resultTypes: ["violations"] }).then((found) => found.violations
  .filter((v) => v.impact === "serious" || v.impact === "critical")
  .flatMap((v) => v.nodes.slice(0, 5).map((n) => `${v.id} (${v.impact}): ${n.target.join(" ")} | ` +
    n.any.concat(n.all, n.none).map((c) => c.message).join("; ").slice(0, 200))))"""


def faults_of_layout(page: Any) -> list[str]:
    """Text over text, cut text, sideways scrolling at the size of the window; empty for a page that reads well."""
    found: list[str] = page.evaluate(_LAYOUT)
    return found


def faults_of_access(page: Any, axe: str) -> list[str]:
    """Violations of axe-core's rules whose impact is serious or critical."""
    if not page.evaluate("() => 'axe' in window"):
        page.evaluate(axe)
    found: list[str] = page.evaluate(_RULES)
    return found
