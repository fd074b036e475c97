"""Sphinx: `make docs`, then docs/_build/html/docs/index.html.

Sources are the pages of this folder and those that they link to elsewhere in the repository.
"""

project = "rfpp"
author = "The rfpp authors"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
root_doc = "docs/index"
include_patterns = ["docs/*.md", "data/*.md", "data/**/*.md", "CONTRIBUTING.md", "CHANGELOG.md"]
exclude_patterns = [
    ".venv",
    "data/shards",
    "data/runs",
    "data/cache",
    "data/renders",
    "docs/_build",
    "launch",
    "rfpp",
    "tests",
]
html_theme = "furo"
html_title = "rfpp"
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # tables that commands write begin with a heading of the second level
