"""Sphinx configuration: `pip install ".[docs]" && sphinx-build docs build/docs`."""

from contactvi.version import version as _version

project = "contactvi"
author = "The contactvi developers"
release = _version()
extensions = ["sphinx.ext.autodoc", "sphinx.ext.mathjax", "myst_parser"]
myst_enable_extensions = ["dollarmath", "amsmath"]
html_theme = "furo"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say shapes and units
exclude_patterns = []


def _sections_as_lists(app, what, name, obj, options, lines):
    """Sections of docstrings (a title underlined with dashes, entries "name : text") become titles and bullets."""
    found, inside = [], False
    for line, after in zip(lines, [*lines[1:], ""], strict=True):
        if line and set(after) == {"-"}:
            found += ["", f"**{line}**", ""]
            inside = True
        elif not line or set(line) == {"-"}:
            inside = inside and bool(line)
            found.append("")
        elif inside:
            entry = line.replace("*", "\\*")
            found.append("- " + entry if not line.startswith(" ") else "  " + entry.lstrip())
        else:
            found.append(line)
    lines[:] = found


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _sections_as_lists)
