"""Sphinx configuration: `pip install ".[docs]" && sphinx-build -W -b html docs build/docs`."""

import re
import sys
from pathlib import Path

from sphinx.domains.python import PyObject

from contactvi.version import version as installed_version

sys.path.insert(0, str(Path(__file__).resolve().parent))

project = "contactvi"
author = "The contactvi developers"
copyright = "The contactvi developers, BSD-3-Clause"
release = installed_version()

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # ships MathJax with the pages: they need no network
    "gallery",  # docs/gallery.py: draws the pictures of the gallery
    "myst_nb",  # MyST pages, and the notebooks of docs/notebooks
]
default_role = "py:obj"  # single backticks in docstrings are code, and links where they name something here
html_theme = "furo"
html_title = "contactvi"


# $...$ is math; every heading down to the third level has an anchor, so that pages link as GitHub does.
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3

# Notebooks are stored without outputs, so that these are never those of another version: each build runs them.
nb_execution_mode = "force"
nb_execution_timeout = 120  # [s] of a cell
nb_execution_raise_on_error = True
nb_merge_streams = True
suppress_warnings = ["mystnb.unknown_mime_type"]

napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # attributes of a class are a list of fields, each documented once
autodoc_member_order = "bysource"
autodoc_typehints = "description"  # types stand beside the text of each argument and link to their classes
autodoc_typehints_description_target = "documented_params"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Selector")}
html_static_path = ["_static"]
html_css_files = ["wide.css"]  # tables of numbers need room

PROPERTIES: list[list[str]] = []  # the docstring of the property that napoleon is busy with


def _keep_properties(app, what, name, obj, options, lines):
    """Napoleon reads "text: more" in a property as a type and its description: keep the lines as they are."""
    if what == "property":
        PROPERTIES.append(list(lines))


def _after_napoleon(app, what, name, obj, options, lines):
    """Restore properties. Of a field of several names, `:ivar t, h:`, Sphinx would take the first one for a type."""
    if what == "property":
        lines[:] = PROPERTIES.pop()
    lines[:] = [re.sub(r"^:ivar ([\w, ]+):", lambda m: f":ivar {m[1].replace(', ', ',')}:", line) for line in lines]


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _keep_properties, priority=400)
    app.connect("autodoc-process-docstring", _after_napoleon, priority=900)
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.rolename = ""  # the names of fields are no links: `t` of one class is not that of another
            field.label = "Attributes"
