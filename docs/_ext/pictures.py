"""Pictures for light and dark pages, and thumbnails of the gallery.

A picture ``NAME.svg`` or ``NAME.png`` with a ``NAME-dark`` beside it is shown as one of the two. Figures of notebooks,
which are SVG, get that dark version here. One of ``docs/_pictures`` made in this build is shown instead.
A list in a container ``examples`` gets the first figure of each page that it links to.
"""

import os
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.util import logging

INK, PAPER = "#20262c", "#ffffff"  # of figures on a light page; greys are mirrored for a dark one
STYLE = {"text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK, "xtick.color": INK, "ytick.color": INK,
         "axes.facecolor": "none", "figure.facecolor": "none", "savefig.facecolor": "none", "legend.facecolor": PAPER,
         "svg.hashsalt": "ldctoolkit", "figure.figsize": (6.4, 4.0)}  # fmt: skip
MADE = Path(__file__).parents[2] / "out" / "pictures"  # by front.py, in each build
_COMMITTED = Path(__file__).parents[1] / "_pictures"


def darkened(svg: str) -> str:
    """The drawing for a dark page: black is white and white is nearly black, dark colours are lighter."""

    def mirrored(found: re.Match[str]) -> str:
        red, green, blue = (int(found[0][i : i + 2], 16) for i in (1, 3, 5))
        if max(red, green, blue) - min(red, green, blue) > 24:
            dark = 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2 < 0.2 * 255**2.2
            part = 0.35 if dark else 0.0  # of white
            return "#" + "".join(f"{round(one + part * (255 - one)):02x}" for one in (red, green, blue))
        return "#" + 3 * f"{round(20 + (255 - (red + green + blue) / 3) * 220 / 255):02x}"

    return re.sub(r"#[0-9a-f]{6}\b(?!-)", mirrored, svg)


def _place(app: Any, node: nodes.image) -> Path:
    return Path(app.env.relfn2path(node["uri"], app.env.docname)[1])


def _as_uri(app: Any, path: Path) -> str:
    folder = Path(app.env.doc2path(app.env.docname)).parent
    return Path(os.path.relpath(path, folder)).as_posix()


def read(app: Any, tree: nodes.document) -> None:
    """Pair light and dark pictures of a page; remember its first figure and which pages its examples are."""
    name, figures = app.env.docname, getattr(app.env, "first_figures", {})
    app.env.first_figures = figures
    figures.pop(name, None)
    for node in list(tree.findall(nodes.image)):
        path = _place(app, node)
        if path.parent == _COMMITTED and (MADE / path.name).is_file():
            path = MADE / path.name
        dark = path.with_stem(path.stem + "-dark")
        if "jupyter_execute" in path.parts and path.suffix == ".svg" and not dark.is_file():
            dark.write_text(darkened(path.read_text(encoding="utf-8")), encoding="utf-8")
        if not str(node.get("alt", "")).strip():
            logging.getLogger(__name__).warning("a picture without alt text: %s", path.name, location=node)
        if not dark.is_file():
            continue
        pair = [node, node.deepcopy()]
        for one, file, shown in zip(pair, (path, dark), ("only-light", "only-dark"), strict=True):
            one["uri"] = _as_uri(app, file)
            one["classes"].append(shown)
        node.parent.insert(node.parent.index(node) + 1, pair[1])
        if "jupyter_execute" in path.parts:
            figures.setdefault(name, (path, dark, node["alt"]))
    for item in (item for box in tree.findall(nodes.container) if "examples" in box["classes"]
                 for item in box.findall(nodes.list_item)):  # fmt: skip
        link = next(iter(item.findall(pending_xref)))
        item["example"] = link["reftarget"]


def resolved(app: Any, tree: nodes.document, _name: str) -> None:
    """Put the thumbnails before their links."""
    for item in tree.findall(lambda node: isinstance(node, nodes.list_item) and "example" in node):
        found = app.env.first_figures.get(item["example"])
        if found is None:
            logging.getLogger(__name__).warning("the example %s has no figure", item["example"], location=item)
            continue
        for path, shown in zip(found[:2], ("only-dark", "only-light")[::-1], strict=True):
            uri = next(uri for uri in app.env.images if Path(app.srcdir, uri).resolve() == path.resolve())
            item.insert(0, nodes.image(uri=uri, alt=found[2], classes=[shown], candidates={"*": uri}))


def setup(app: Any) -> dict[str, bool]:
    """Connect, before Sphinx collects the pictures of a page."""
    app.connect("doctree-read", read, priority=400)
    app.connect("doctree-resolved", resolved)
    return {"parallel_read_safe": False}
