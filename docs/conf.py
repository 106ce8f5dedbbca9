"""Sphinx, offline, warnings are errors: ``sphinx-build -W -b html docs docs/_build/html``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
for folder in (HERE / "_ext", HERE.parent / "factors", HERE.parent):
    sys.path.insert(0, str(folder))
# The kernels of notebooks find the same sources, wherever the package is installed from.
before = os.environ.get("PYTHONPATH", "").split(os.pathsep)
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(HERE.parent), str(HERE.parent / "factors"), *filter(None, before)]
)

from relnav_graph.constants import VERSION  # noqa: E402

project = "relnav-graph"
author = "The relnav-graph authors"
copyright = "the relnav-graph authors; MIT licence"
version = release = VERSION

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx_click",
    "sphinx_design",
    "relnav_reference",
]
exclude_patterns = ["_build", "jupyter_execute", "explanation/validation_table.md"]
source_suffix = {".md": "myst-nb", ".rst": "restructuredtext"}
default_role = "code"
smartquotes = False  # formulas and options have their own dashes and quotes

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_show_tb = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True

html_theme = "furo"
html_title = f"relnav-graph {VERSION}"
html_static_path = ["_static"]
html_css_files = ["relnav.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}

# MathJax 3.2.2 (Apache License 2.0, _static/mathjax-LICENSE.txt), one file with its SVG fonts.
mathjax_path = "mathjax-tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}
