"""Pages of a report, and what a reader sees of them."""

import base64
import dataclasses
import json
import re
from collections import Counter
from collections.abc import Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

VOID = {"meta", "br", "link", "img", "input", "hr"}
EVIL = "<script>alert(1)</script> \"q\" 'x' & \u202e"  # text of a user that must stay text


@dataclasses.dataclass
class Table:
    """A table: where it stands, its caption, and its cells with single spaces."""

    section: str
    caption: str = ""
    rows: list[list[str]] = dataclasses.field(default_factory=list)


class Page(HTMLParser):
    """A page, or a part of one; refuses tags that are not closed in order, identifiers twice and links to nothing.
    `text` holds the text of each section without that of its drawings, which is in `drawn`."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html = html
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images: list[str] = []
        self.tables: list[Table] = []
        self.text: dict[str, str] = {"": ""}
        self.drawn = ""
        self.counts: Counter[str] = Counter()
        self._open: list[str] = []
        self._section = ""
        self.feed(html)
        self.close()
        assert (self._open, len(self.ids)) == ([], len(set(self.ids)))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._seen(tag, {key: value or "" for key, value in attrs})
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._seen(tag, {key: value or "" for key, value in attrs})

    def _seen(self, tag: str, given: dict[str, str]) -> None:
        self.counts[tag] += 1
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[key] for key in ("href", "src") if key in given and tag != "use"]
        self.links += ["#" + given["aria-labelledby"]] if "aria-labelledby" in given else []
        self.links += ["#" + name for value in given.values() for name in re.findall(r"url\(#([^)]+)\)", value)]
        if given.get("role") == "img":
            self.images.append(given.get("aria-label", ""))
        if tag == "section":
            self._section = given.get("id", "")
            self.text[self._section] = ""
        elif tag == "table":
            self.tables.append(Table(self._section))
        elif tag == "tr":
            self.tables[-1].rows.append([])
        elif tag in ("td", "th"):
            self.tables[-1].rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag
        if tag == "section":
            self._section = ""
        elif tag in ("td", "th"):
            self.tables[-1].rows[-1][-1] = " ".join(self.tables[-1].rows[-1][-1].split())

    def handle_data(self, data: str) -> None:
        if {"script", "style"} & set(self._open):
            return
        if "svg" in self._open:
            self.drawn += data
            return
        self.text[self._section] += data
        if "caption" in self._open:
            self.tables[-1].caption += data
        elif "td" in self._open or "th" in self._open:
            self.tables[-1].rows[-1][-1] += data

    def words(self, section: str = "") -> str:
        """The text of a section with single spaces, of what stands in no section by default."""
        return " ".join(self.text[section].split())

    @property
    def all_words(self) -> str:
        """The text of all sections with single spaces."""
        return " ".join(" ".join(self.text.values()).split())

    def filled(self, section: str | None = None) -> list[list[list[str]]]:
        """Rows of the tables that have some; of one section, if it is given."""
        return [one.rows for one in self.tables if one.rows and section in (None, one.section)]

    def headed(self, *head: str) -> list[list[list[str]]]:
        """Tables whose first row holds all of these cells."""
        return [rows for rows in self.filled() if set(head) <= set(rows[0])]

    def captioned(self, caption: str) -> list[list[str]]:
        """Rows of the one table whose caption begins like this."""
        (found,) = (one.rows for one in self.tables if one.caption.startswith(caption))
        return found

    @property
    def captions(self) -> list[str]:
        """Of all tables that have one."""
        return [one.caption for one in self.tables if one.caption]

    @property
    def data(self) -> dict[str, Any]:
        """What the page's script is given."""
        found = re.search(r'<script type="application/json" id="data">(.*?)</script>', self.html, re.DOTALL)
        content: dict[str, Any] = json.loads(found[1])
        return content


def whole(page: Page) -> None:
    """Nothing is fetched, links lead somewhere, and no number is missing where one is shown."""
    links = {one for one in page.links if not one.startswith("data:image/png;base64,")}
    assert links <= {"#" + name for name in page.ids}
    assert not re.search(r"https?:|@import|@font-face|<link|<iframe|[\"'(=]\s*//[a-z]", page.html)
    assert not re.search(r"\bnan\b", page.all_words + " ".join(page.images))


def unpacked(one: Mapping[str, str]) -> npt.NDArray[Any]:
    """The numbers of a packed array."""
    return np.frombuffer(base64.b64decode(one["data"]), dtype=f"<{one['type']}")


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
