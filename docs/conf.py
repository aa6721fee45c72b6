"""Sphinx configuration: `pip install ".[docs]" && sphinx-build docs build/docs`."""

from contactvi.version import version as _version

project = "contactvi"
author = "The contactvi developers"
release = _version()
extensions = ["sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.napoleon", "myst_parser"]
myst_enable_extensions = ["dollarmath", "amsmath"]
html_theme = "furo"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say shapes and units
exclude_patterns = []
