"""The documentation site: ``sphinx-build -W docs build/site``."""

import os
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent)]
os.environ |= {"COLUMNS": "90", "NO_COLOR": "1"}  # of what commands print

project = "pinconsist"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "site_extension",
]
exclude_patterns = ["_templates"]
templates_path = ["_templates"]

myst_heading_anchors = 3
nitpicky = True
nitpick_ignore_regex = [("py:class", "Path|RobotWrapper"), ("py:mod", r"\w+")]  # of others; inner modules
default_role = "code"
autodoc_typehints = "none"  # the docstrings say more

html_theme = "furo"
html_title = "pinconsist"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
copybutton_exclude = ".linenos, .gp, .go"
