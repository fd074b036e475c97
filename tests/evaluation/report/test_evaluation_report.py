"""report.html: what it says is what was measured, and nothing in it comes from elsewhere or runs by accident."""

import base64
import io
import re
from contextlib import suppress
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from rfpp.errors import UserError
from rfpp.evaluation.measuring.csv_files import read_buckets, read_scenes
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.report.evaluation_report import main, write_report
from rfpp.evaluation.report.picture_archive import MAX_PIXELS, read_pictures, write_pictures

SCENES = {"a": (500, 0.1), "b": (2000, 0.4), "c": (800, 0.25)}
HOSTILE = (
    '<script>alert("x")</script>', '"><img src=x onerror=alert(1)>', "{{ 7 * 7 }}{% raw %}", "../../etc/passwd",
    "</style><b>", "a,b\nc", "$\\frac{1}{", "--><b>", "é ↓",
)  # fmt: skip


class Page(HTMLParser):
    """The elements of a page with their attributes and their own text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self._open: list[str] = []
        self.rows: dict[str, list[float]] = {}  # by what the row is of, its numbers
        self._row: list[float] | None = None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.elements.append((tag, values))
        self._open.append(tag)
        if tag in ("tr", "article"):
            name = next((values[key] for key in ("data-predictor", "data-bucket", "data-scene") if key in values), "")
            self._row = self.rows.setdefault(name, [])
        if tag == "data" and self._row is not None:
            self._row.append(float(values["value"]))

    def handle_data(self, data):
        self.texts.append((self._open[-1] if self._open else "", data))


def _page(folder) -> tuple[str, Page]:
    text = write_report(folder).read_text(encoding="utf-8")
    return text, Page(text)


def test_numbers_are_those_of_the_files(evaluated):
    folder = evaluated(SCENES)
    _, page = _page(folder)
    means = Evaluation.read(folder / "evaluation.json").means
    for predictor in ("model", "black"):
        assert page.rows[predictor] == [estimate.mean for estimate in means["test", predictor].values()]
    small, large = [b for b in read_buckets(folder, ["log_l1", "psnr"]) if b.counted == "triangles"]
    assert page.rows["triangles 0–999"] == [small.estimates["log_l1"].mean, small.estimates["psnr"].mean]
    assert page.rows["triangles ≥ 1000"] == [large.estimates["log_l1"].mean, 26.0]
    assert page.rows["b"] == [0.4, 26.0]


def test_intervals_and_the_best_are_marked(evaluated):
    folder = evaluated(SCENES)
    text, _ = _page(folder)
    model = Evaluation.read(folder / "evaluation.json").means["test", "model"]["log_l1"]
    row = text[text.index('<tr data-predictor="model">') : text.index('<tr data-predictor="black">')]
    assert f"<small>{model.low:.4f}–{model.high:.4f}</small>" in row
    assert row.count('class="best"') == 2  # as good as black in PSNR
    assert text.count('class="best"') == 3


def test_what_was_evaluated_is_said(evaluated):
    about = {"method": "RenderFormer++ w/o TCL", "seed": 3, "steps": None, "commit": "c0ffee", "hardware": "a machine"}
    text, _ = _page(evaluated(SCENES, **about, data_manifest="0123456789"))
    for fact in ("RenderFormer++ w/o TCL", "seed 3", "unknown steps", "c0ffee", "a machine", "0123456789"):
        assert fact in text


def test_scenes_stand_worst_first_with_their_places(evaluated):
    text, page = _page(evaluated(SCENES))
    articles = [values for tag, values in page.elements if tag == "article"]
    assert [article["data-scene"] for article in articles] == ["b", "c", "a"]
    assert [article["data-triangles"] for article in articles] == ["2000", "800", "500"]
    assert re.findall(r'class="place">(\w+)<', text) == ["worst", "median", "best"]
    assert "rank 2 of 3" in text


def test_a_single_scene_is_best_median_and_worst_and_has_no_interval(evaluated):
    text, _ = _page(evaluated({"a": (500, 0.1)}))
    assert re.findall(r'class="place">(\w+)<', text) == ["best", "median", "worst"]
    assert "<small>—</small>" in text


def test_scripts_can_read_numbers_that_are_none(evaluated):
    _, page = _page(evaluated({"a": (500, float("nan")), "b": (2000, float("-inf")), "c": (5, 0.1)}))
    values = {v["data-scene"]: (v["data-log_l1"], v["data-psnr"]) for tag, v in page.elements if tag == "article"}
    assert values["a"] == ("NaN", "NaN")
    assert values["b"] == ("-Infinity", "Infinity")


def test_nothing_comes_from_elsewhere(evaluated):
    text, page = _page(evaluated(SCENES))
    assert not re.search(r"https?://", text)
    linked = [
        value
        for _, values in page.elements
        for key, value in values.items()
        if key in ("src", "href", "xlink:href", "srcset", "action", "poster", "data")
    ]
    assert len(linked) > 15
    assert all(value.startswith(("data:image/", "#")) for value in linked)
    assert not [tag for tag, _ in page.elements if tag in ("link", "iframe", "object", "embed", "base")]
    assert not re.search(r"@import|url\((?!#)", text)


def test_hostile_names_are_text(evaluated):
    scenes = {name: (500 + i, 0.1 + i / 100) for i, name in enumerate(HOSTILE)}
    text, page = _page(evaluated(scenes, method=HOSTILE[0], hardware=HOSTILE[1], commit=HOSTILE[2]))
    assert {values["data-scene"] for tag, values in page.elements if tag == "article"} == set(HOSTILE)
    assert sum(tag == "script" for tag, _ in page.elements) == 1
    assert not [values for _, values in page.elements if any(key.startswith("on") for key in values)]
    assert all(values.get("src", "data:").startswith("data:") for _, values in page.elements)
    assert "{{ 7 * 7 }}" in text


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_predictor_is_text_in_tables_and_plots(evaluated, name):
    _, page = _page(evaluated(SCENES, baseline=name))
    assert len(page.rows[name]) == 2
    assert "".join(text for tag, text in page.texts if tag == "text").count(name.replace("\n", " ")) == 2
    assert sum(tag == "script" for tag, _ in page.elements) == 1
    assert not [tag for tag, _ in page.elements if tag == "b"]


def test_pictures_are_those_that_were_stored(tmp_path):
    noise = np.random.default_rng(0).integers(256, size=(24, 40, 3), dtype=np.uint8)
    write_pictures(
        {("test", "a/../b"): {"reference": noise, "prediction": noise.repeat(20, 0).repeat(20, 1)}}, tmp_path
    )
    (of_scene,) = read_pictures(tmp_path).values()
    assert list(read_pictures(tmp_path)) == [("test", "a/../b")]
    small, large = (np.asarray(Image.open(io.BytesIO(of_scene[n].content))) for n in ("reference", "prediction"))
    np.testing.assert_array_equal(small, noise)
    assert (of_scene["prediction"].width, of_scene["prediction"].height) == (large.shape[1], large.shape[0])
    assert max(large.shape) == MAX_PIXELS


def test_pictures_are_in_the_page(evaluated):
    folder = evaluated(SCENES)
    _, page = _page(folder)
    addresses = {values["alt"]: values["src"] for tag, values in page.elements if tag == "img"}
    for kind in ("reference", "prediction", "error", "direct light", "albedo"):
        (address,) = (src for alt, src in addresses.items() if alt.lower() == f"{kind} of b")
        content = base64.b64decode(address.removeprefix("data:image/webp;base64,"))
        assert content == read_pictures(folder)["test", "b"][kind].content


def test_the_command_makes_the_page_again(evaluated, capsys):
    folder = evaluated(SCENES)
    first = write_report(folder).read_bytes()
    (folder / "report.html").unlink()
    main([str(folder)])
    assert capsys.readouterr().out == f"{folder / 'report.html'}\n"
    assert (folder / "report.html").read_bytes() == first


def test_a_page_of_many_scenes_stays_small(evaluated):
    folder = evaluated({f"scene-{i}": (500 + i, i / 3000) for i in range(3000)})
    write_pictures(
        {("test", "scene-7"): dict.fromkeys(("reference", "prediction"), np.zeros((8, 8, 3), np.uint8))}, folder
    )
    assert write_report(folder).stat().st_size < 300_000


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("evaluation.json", None, "evaluation.json: cannot be read"),
        ("evaluation.json", b"{", "evaluation.json: not an evaluation"),
        ("test_scenes.csv", None, "test_scenes.csv: cannot be read"),
        ("test_scenes.csv", b"", "test_scenes.csv: not of the same evaluation"),
        ("test_scenes.csv", b"scene,triangles\na,many\n", "test_scenes.csv: not what launch/evaluate.py writes"),
        ("test_scenes.csv", b"\xff\x00", "test_scenes.csv: not what launch/evaluate.py writes"),
        ("buckets.csv", b"split,counted,from,below\ntest,triangles,0\n", "buckets.csv: not what"),
        ("pictures.zip", None, "pictures.zip: cannot be read"),
        ("pictures.zip", b"PK", "pictures.zip: cannot be read"),
    ],
)
def test_a_damaged_file_is_one_line(evaluated, capsys, file, content, message):
    folder = evaluated(SCENES)
    (folder / file).unlink() if content is None else (folder / file).write_bytes(content)
    with pytest.raises(SystemExit) as stop:
        main([str(folder)])
    assert message in str(stop.value)
    assert str(stop.value).startswith(f"error: {folder}") and "\n" not in str(stop.value)
    assert not (folder / "report.html").exists()


def test_pictures_of_other_scenes_are_refused(evaluated):
    folder = evaluated(SCENES)
    write_pictures({("test", "of another data set"): {}}, folder)
    with pytest.raises(UserError, match=r"pictures.zip: not of the same evaluation"):
        write_report(folder)


def test_a_flipped_byte_in_the_pictures_is_never_a_traceback(evaluated):
    path = evaluated(dict(list(SCENES.items())[:1])) / "pictures.zip"
    sound = path.read_bytes()
    random = np.random.default_rng(0)
    for at in random.integers(len(sound), size=200):
        path.write_bytes(sound[:at] + bytes([sound[at] ^ random.integers(1, 256)]) + sound[at + 1 :])
        with suppress(UserError):
            read_pictures(path.parent)


def test_records_and_buckets_are_read_as_they_were_written(evaluated):
    folder = evaluated(SCENES)
    records = read_scenes(folder, "test", ["log_l1", "psnr"])
    assert [(r.scene, r.triangles, r.predictor) for r in records[:2]] == [("a", 500, "model"), ("b", 2000, "model")]
    assert records[1].values == {"log_l1": 0.4, "psnr": 26.0}
    buckets = read_buckets(folder, ["log_l1", "psnr"])
    assert [(b.counted, b.label) for b in buckets] == [
        ("triangles", "0–999"),
        ("triangles", "≥ 1000"),
        ("objects", "≥ 5"),
    ]
    assert np.isnan(buckets[1].estimates["log_l1"].low)
