"""Sphinx configuration: `pip install ".[docs]" && sphinx-build -W -b html docs build/docs`."""

import re

from sphinx.domains.python import PyObject

from contactvi.version import version as installed_version

project = "contactvi"
author = "The contactvi developers"
copyright = "The contactvi developers, BSD-3-Clause"
release = installed_version()

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # ships MathJax with the pages: they need no network
    "myst_parser",
]
default_role = "code"  # single backticks in docstrings are code, as in Markdown
html_theme = "furo"
html_title = f"contactvi {release}"


# $...$ is math; every heading down to the third level has an anchor, so that pages link as GitHub does.
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3

napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # attributes of a class are a list of fields, each documented once
autodoc_member_order = "bysource"
autodoc_typehints = "description"  # types stand beside the text of each argument and link to their classes
autodoc_typehints_description_target = "documented"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True


def _join_names(app, what, name, obj, options, lines):
    """A field of several names, `:ivar t, h:`, would be read as the name h of the type t: close the gap."""
    lines[:] = [re.sub(r"^:ivar ([\w, ]+):", lambda m: f":ivar {m[1].replace(', ', ',')}:", line) for line in lines]


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _join_names, priority=900)  # after napoleon
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.rolename = ""  # the names of fields are no links: `t` of one class is not that of another
