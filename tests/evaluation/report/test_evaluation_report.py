"""report.html shows the measured numbers, loads nothing external and escapes every name."""

import re
from html.parser import HTMLParser

import pytest

SCENES = {"a": (500, 0.1), "b": (2000, 0.4), "c": (800, 0.25)}
HOSTILE = (
    '<script>alert("x")</script>', '"><img src=x onerror=alert(1)>', "{{ 7 * 7 }}{% raw %}", "../../etc/passwd",
    "</style><b>", "a,b\nc", "$\\frac{1}{", "--><b>", "é ↓", "\ud800",
)  # fmt: skip


class Page(HTMLParser):
    """Elements of a page with their attributes, and numbers of its rows and cards."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self._open: list[str] = []
        self.rows: dict[str, list[float]] = {}  # numbers by predictor or scene
        self._row: list[float] | None = None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.elements.append((tag, values))
        self._open.append(tag)
        if tag in ("tr", "article"):
            name = next((values[key] for key in ("data-predictor", "data-scene") if key in values), "")
            self._row = self.rows.setdefault(name, [])
        if tag == "data" and self._row is not None:
            self._row.append(float(values["value"]))

    def handle_data(self, data):
        self.texts.append((self._open[-1] if self._open else "", data))


def _page(path) -> tuple[str, Page]:
    text = path.read_text(encoding="utf-8")
    return text, Page(text)


def test_numbers_are_those_measured(reported):
    text, page = _page(reported(SCENES))
    assert page.rows["model"] == pytest.approx([0.25, 27.5])
    assert page.rows["black"] == pytest.approx([0.9, 27.5])
    assert page.rows["b"] == pytest.approx([0.4, 26.0])
    assert text.count('class="best"') == 3  # the model's log-L1, and the same PSNR twice
    assert "<small>0.1000–0.4000</small>" in text


def test_ablation_and_convergence_are_shown_where_measured(reported):
    measured = {
        "ablation": {"test": {"other_tokens": 0.02, "no_operator": 1.08}},
        "transport": {"test": {"residual": [0.5, 0.25], "log_l1": [0.3, 0.2]}},
    }
    text, page = _page(reported(SCENES, **measured))
    assert "with another scene&#39;s tokens +2%, without the operator +108%" in text
    assert [page.rows[f"k={k}"] for k in range(2)] == [[0.3], [0.2]]
    assert "<td>0.25</td>" in text
    text, _ = _page(reported(SCENES))
    assert "Ablation" not in text and "Transport" not in text


def test_scenes_are_ordered_worst_first_with_their_places(reported):
    text, page = _page(reported(SCENES))
    assert [values["data-scene"] for tag, values in page.elements if tag == "article"] == ["b", "c", "a"]
    assert re.findall(r'class="place">(\w+)<', text) == ["worst", "median", "best"]
    assert "rank 2 of 3" in text


def test_a_single_scene_is_best_median_and_worst_and_has_no_interval(reported):
    text, _ = _page(reported({"a": (500, 0.1)}))
    assert re.findall(r'class="place">(\w+)<', text) == ["best", "median", "worst"]
    assert "<small>—</small>" in text


def test_nothing_external_is_loaded(reported):
    text, page = _page(reported(SCENES))
    assert not re.search(r"https?://", text)
    keys = ("src", "href", "xlink:href", "srcset", "action", "poster", "data")
    linked = [value for _, values in page.elements for key, value in values.items() if key in keys]
    assert len(linked) > 15
    assert all(value.startswith(("data:image/", "#")) for value in linked)
    assert not [tag for tag, _ in page.elements if tag in ("link", "iframe", "object", "embed", "base")]
    assert not re.search(r"@import|url\((?!#)", text)


def test_hostile_names_are_text(reported):
    scenes = {name: (500 + i, 0.1 + i / 100) for i, name in enumerate(HOSTILE[:9])}
    about = {"method": HOSTILE[0], "hardware": HOSTILE[1], "commit": HOSTILE[2], "baseline": HOSTILE[9]}
    text, page = _page(reported(scenes, **about))
    assert {values["data-scene"] for tag, values in page.elements if tag == "article"} == set(scenes)
    assert sum(tag == "script" for tag, _ in page.elements) == 1
    assert not [values for _, values in page.elements if any(key.startswith("on") for key in values)]
    assert all(values.get("src", "data:").startswith("data:") for _, values in page.elements)
    assert not [tag for tag, _ in page.elements if tag == "b"]
    assert "{{ 7 * 7 }}" in text
