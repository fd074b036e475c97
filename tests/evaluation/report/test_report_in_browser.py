"""report.html as people use it: opened from a file in Chromium."""

import numpy as np
import pytest
from browser import picture_of, requires_chromium

from rfpp.evaluation.report.evaluation_report import write_report

pytestmark = requires_chromium

RED, BLUE = np.array((255, 0, 0)), np.array((0, 0, 255))
SCENES = {"a": (500, 0.1), "b": (2000, 0.4), "c": (800, 0.25), '"><img src=x onerror=alert(1)>': (900, 0.3)}


@pytest.fixture
def page(browser, evaluated):
    browser.get(write_report(evaluated(SCENES)).as_uri())
    return browser


@pytest.fixture
def wipe(page):
    return page.find_element("css selector", "article .wipe")


def _share_of_prediction(wipe) -> float:
    """How much of a line across the picture is red, the prediction's colour; the rest is the reference's blue."""
    line = picture_of(wipe)[40].astype(int)
    red, blue = (np.abs(line - colour).max(axis=1) < 40 for colour in (RED, BLUE))
    assert (red | blue).mean() > 0.9  # but for the line between them
    if red.any() and blue.any():
        assert np.flatnonzero(red).max() < np.flatnonzero(blue).min()  # on the left
    return red.sum() / (red | blue).sum()


def _visible_scenes(page) -> list[str]:
    articles = page.find_elements("css selector", "article")
    return [article.get_attribute("data-scene") for article in articles if article.is_displayed()]


def _choose(page, element: str, text: str) -> None:
    from selenium.webdriver.support.select import Select

    Select(page.find_element("id", element)).select_by_visible_text(text)


def _set(page, element: str, value: int) -> None:
    """As a pointer would: the value and the event that follows it."""
    script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input', {bubbles: true}))"
    page.execute_script(script, page.find_element("id", element), value)


def test_it_loads_nothing_from_elsewhere_and_all_its_pictures(page):
    loaded = page.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
    assert all(address.startswith("data:") for address in loaded)
    decoded = "return [...document.images].map(image => image.complete && image.naturalWidth)"
    scale, *pictures = page.execute_script(decoded)
    assert scale == 128
    assert pictures == [32] * 5 * len(SCENES)
    assert "RenderFormer++" in page.title


def test_the_pointer_wipes_from_the_prediction_to_the_reference(page, wipe):
    from selenium.webdriver import ActionChains

    assert _share_of_prediction(wipe) == pytest.approx(0.5, abs=0.02)
    quarter = wipe.size["width"] // 4
    ActionChains(page).move_to_element_with_offset(wipe, -quarter, 30).click().perform()
    assert _share_of_prediction(wipe) == pytest.approx(0.25, abs=0.02)
    drag = ActionChains(page).move_to_element(wipe).click_and_hold().move_by_offset(-quarter, 0)
    drag.move_by_offset(2 * quarter, 0).release().perform()
    assert _share_of_prediction(wipe) == pytest.approx(0.75, abs=0.02)


def test_the_keyboard_wipes_too_and_says_where_it_is(page, wipe):
    from selenium.webdriver import Keys

    slider = wipe.find_element("tag name", "input")
    slider.send_keys(Keys.HOME)
    assert _share_of_prediction(wipe) == 0
    slider.send_keys(Keys.END)
    assert _share_of_prediction(wipe) == 1
    slider.send_keys(*[Keys.ARROW_LEFT] * 10)
    assert _share_of_prediction(wipe) == pytest.approx(0.9, abs=0.02)
    assert slider.get_attribute("aria-valuetext") == "90% prediction"
    assert "b" in slider.accessible_name and slider.aria_role == "slider"


def test_every_control_has_a_name(page):
    for control in page.find_elements("css selector", "input, select"):
        assert control.accessible_name


def test_the_filters_hide_scenes_by_triangles(page):
    assert len(_visible_scenes(page)) == 4
    _set(page, "from", 850)
    assert set(_visible_scenes(page)) == {"b", '"><img src=x onerror=alert(1)>'}
    assert page.find_element("id", "shown").text == "2 of 4 scenes shown"
    _set(page, "to", 1999)
    assert _visible_scenes(page) == ['"><img src=x onerror=alert(1)>']
    _set(page, "to", 600)  # takes the lower end along
    assert page.find_element("id", "from").get_attribute("value") == "600"
    assert _visible_scenes(page) == []
    _set(page, "from", 500)
    assert _visible_scenes(page) == ["a"]


def test_a_split_can_be_chosen(page):
    page.execute_script("document.querySelector('article').dataset.split = 'another'")
    _choose(page, "split", "test")
    assert len(_visible_scenes(page)) == 3
    _choose(page, "split", "all")
    assert len(_visible_scenes(page)) == 4


def test_the_order_follows_the_choice(page):
    hostile = '"><img src=x onerror=alert(1)>'
    assert _visible_scenes(page) == ["b", hostile, "c", "a"]
    _choose(page, "order", "log-L1, best first")
    assert _visible_scenes(page) == ["a", "c", hostile, "b"]
    _choose(page, "order", "PSNR, worst first")
    assert _visible_scenes(page) == ["b", hostile, "c", "a"]
    _choose(page, "order", "triangles, fewest first")
    assert _visible_scenes(page) == ["a", "c", hostile, "b"]


def test_scenes_without_a_number_are_the_worst(browser, evaluated):
    browser.get(write_report(evaluated({"a": (5, 0.1), "b": (6, float("nan")), "c": (7, 0.3)})).as_uri())
    assert _visible_scenes(browser) == ["b", "c", "a"]
    _choose(browser, "order", "log-L1, best first")
    assert _visible_scenes(browser) == ["a", "c", "b"]


@pytest.mark.parametrize("width", [1280, 400])
def test_only_tables_are_wider_than_the_screen(page, width):
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": True}
    )
    try:
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
