"""How Sphinx builds these pages: ``sphinx -W -b html docs docs/_build/html``."""

import importlib.metadata

project = "esair"
author = "the esair authors"
copyright = "2026 the esair authors"  # noqa: A001
version = release = importlib.metadata.version("esair")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinxcontrib.svgbob",
]
exclude_patterns = ["_build", "code"]
html_theme = "furo"
html_title = f"esair {release}"
html_copy_source = False

# The docstrings name things in single backticks.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
python_display_short_literal_types = True

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3


def setup(app):
    """Show docstrings of attributes as they are.

    Napoleon takes what stands before a colon in them for a type.
    """
    written = {}

    def keep(_app, what, name, _thing, _options, lines):
        if what in {"attribute", "property"}:
            written[name] = list(lines)

    def restore(_app, what, name, _thing, _options, lines):
        if what in {"attribute", "property"}:
            lines[:] = written.pop(name)

    app.connect("autodoc-process-docstring", keep, priority=400)
    app.connect("autodoc-process-docstring", restore, priority=600)
