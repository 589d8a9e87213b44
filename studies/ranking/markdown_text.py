"""Text of users as text of a Markdown file: nothing in it is markup, a link, or the end of a cell."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Final

_ENTITIES: Final = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_MARKS: Final = frozenset("\\`*_[]|~#$")
_ADDRESS: Final = re.compile(r"(?i)\b(www)(\.)|()(:)(?=\S)")
_START: Final = re.compile(r"^(\d{1,9})([.)])|^([-+=])")


def markdown_text(text: str) -> str:
    r"""One line of text that a reader of GitHub-flavoured Markdown shows as it is.

    Parameters
    ----------
    text : str
        Anything; line ends and other control characters become spaces.

    Returns
    -------
    str
        With backslashes and entities where a character could mean something.

    Examples
    --------
    >>> print(markdown_text("a|b <script> `c`\n* d"))
    a\|b &lt;script&gt; \`c\` \* d
    >>> print(markdown_text("1. K_y"))
    1\. K\_y
    """
    line = re.sub(r"[\x00-\x20\x7f\x85\u2028\u2029]+", " ", text).strip()
    # halves of characters, and what turns the direction of the text that follows
    line = re.sub("[\ud800-\udfff\u202a-\u202e\u2066-\u2069]", "\ufffd", line)
    shown = "".join(_ENTITIES.get(one, f"\\{one}" if one in _MARKS else one) for one in line)
    # no address, emoji or mention: a mark inside the word ends what would be one
    shown = _ADDRESS.sub(lambda m: f"{m[1] or ''}\\{m[2] or m[4]}", shown).replace("@", "@<!-- -->")
    return _START.sub(lambda m: f"{m[1]}\\{m[2]}" if m[1] else f"\\{m[3]}", shown)


def markdown_table(headings: Sequence[str], right: Sequence[bool], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells are escaped already.

    Parameters
    ----------
    headings : sequence of str
    right : sequence of bool
        Which columns stand to the right.
    rows : iterable of sequence of str

    Returns
    -------
    str
    """
    rule = ["---:" if number else "---" for number in right]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (headings, rule, *rows))
