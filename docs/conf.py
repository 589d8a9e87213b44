"""Configuration of Sphinx; `make docs` builds the site into out/docs."""

import dataclasses
import os
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the pages' own kernels, too

import front
import generated
from pictures import MADE, STYLE
from sphinx.util import logging

import ldctoolkit

# kernels warn of every connection that is not encrypted, also on one machine
profile = Path(__file__).parents[1] / "out/ipython/profile_default"
profile.mkdir(parents=True, exist_ok=True)
figures = f"c.InlineBackend.figure_formats = ['svg']\nc.InlineBackend.rc = {STYLE!r}\n"
(profile / "ipython_kernel_config.py").write_text(f"c.IPKernelApp.log_level = 'ERROR'\n{figures}")
os.environ["IPYTHONDIR"] = str(profile.parent)

generated.write(Path(__file__).parent / "reference" / "_generated")
if missing := front.write(MADE):
    logging.getLogger(__name__).info("The first page shows the report's stored picture: %s.", missing)

project, author = "ldctoolkit", "The ldctoolkit developers"
version = release = ldctoolkit.__version__
copyright = author
extensions = ["pictures", "myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.autosummary"]
exclude_patterns = ["_ext", "reference/_generated"]
templates_path = ["_templates"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_sidebars = {page: [] for page in ("index", "tutorial", "contributing")}
html_theme = "pydata_sphinx_theme"
html_title = "ldctoolkit"
html_theme_options = {
    "secondary_sidebar_items": ["page-toc"], "show_prev_next": False, "navbar_persistent": ["search-button"],
}  # fmt: skip
html_copy_source = False

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = True
nb_merge_streams = True

autosummary_generate = True
# beside Gain and Study, where a file system does not tell capitals
autosummary_filename_map = {f"ldctoolkit.{name}": f"ldctoolkit.{name}-function" for name in ("gain", "study")}
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
autodoc_typehints = "none"  # docstrings have them
autodoc_member_order = "bysource"
default_role = "autolink"


def complete(_app: Any, what: str, _name: str, thing: Any, _options: Any, lines: list[str]) -> None:
    """Add the fields of a dataclass that its docstring leaves to comments; |e_y| is an amount, and no substitution."""
    if what == "class" and dataclasses.is_dataclass(thing) and "Attributes\n" not in (thing.__doc__ or ""):
        known = generated.comments(thing).items()
        lines += ["", *(f":ivar {name}: {text}" for name, text in known if text != "the same"), ""]
    lines[:] = [
        line if line.lstrip().startswith((">>>", "...")) else re.sub(r"(?<!`)\|", r"\\|", line) for line in lines
    ]


def setup(app: Any) -> None:
    """Connect."""
    app.connect("autodoc-process-docstring", complete)
