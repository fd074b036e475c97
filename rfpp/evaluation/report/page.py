"""Render the HTML templates in `pages/`. All inserted content is escaped."""

from __future__ import annotations

import base64
import json

from jinja2 import Environment, PackageLoader, StrictUndefined

from rfpp.evaluation.measuring.number_text import interval_text, number_text
from rfpp.evaluation.report.picture_archive import StoredPicture
from rfpp.metrics.image import METRICS

_PAGES = Environment(
    loader=PackageLoader("rfpp.evaluation.report", "pages"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def page(template: str, **content: object) -> bytes:
    """The template filled with `content`, as UTF-8."""
    text = _PAGES.get_template(template).render(content)
    return text.encode("utf-8", "replace")  # half a surrogate pair, which no file can hold


def _data_uri(picture: StoredPicture) -> str:
    """An address that holds the picture itself."""
    return f"data:image/webp;base64,{base64.b64encode(picture.content).decode()}"


_PAGES.globals.update(
    metrics=METRICS,
    number_text=number_text,
    interval_text=interval_text,
    script_number=json.dumps,  # spells infinity and NaN as JavaScript does
    data_uri=_data_uri,
)
