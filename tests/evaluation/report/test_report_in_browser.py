"""report.html in Chromium, opened from a file."""

import numpy as np
import pytest
from browser import picture_of, requires_chromium

pytestmark = requires_chromium

RED, BLUE = np.array((255, 0, 0)), np.array((0, 0, 255))
SCENES = {"a": (500, 0.1), "b": (2000, 0.4), "c": (800, 0.25), '"><img src=x onerror=alert(1)>': (900, 0.3)}


@pytest.fixture
def page(browser, reported):
    browser.get(reported(SCENES).as_uri())
    return browser


@pytest.fixture
def wipe(page):
    return page.find_element("css selector", "article .wipe")


def _share_of_prediction(wipe) -> float:
    """Return the share of a line across the picture that is red, like the prediction; the reference is blue."""
    line = picture_of(wipe)[40].astype(int)
    red, blue = (np.abs(line - color).max(axis=1) < 40 for color in (RED, BLUE))
    assert (red | blue).mean() > 0.9  # except for the line between them
    if red.any() and blue.any():
        assert np.flatnonzero(red).max() < np.flatnonzero(blue).min()  # on the left
    return red.sum() / (red | blue).sum()


def test_it_loads_all_pictures_and_nothing_external(page):
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


@pytest.mark.parametrize("width", [1280, 400])
def test_only_tables_are_wider_than_the_screen(page, width):
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": True}
    )
    try:
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
