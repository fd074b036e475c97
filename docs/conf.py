"""Configuration of Sphinx; `make docs` writes docs/_build/html/docs/index.html."""

project = "rfpp"
author = "The rfpp authors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
default_role = "code"  # as in Markdown
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "member-order": "bysource"}
napoleon_use_ivar = True
source_suffix = {".md": "markdown"}
root_doc = "docs/index"
include_patterns = ["docs/*.md", "data/*.md", "CONTRIBUTING.md", "CHANGELOG.md"]
html_theme = "furo"
html_title = "rfpp"
myst_heading_anchors = 3
