"""The page in Chromium: it shows the image, controls change it, visitors are independent."""

import time

import numpy as np
import pytest
from browser import picture_of, requires_chromium
from scipy.ndimage import binary_dilation, distance_transform_edt

pytestmark = requires_chromium


def canvas(browser) -> np.ndarray:
    return picture_of(browser.find_element("css selector", "canvas"))


def until(condition, seconds=60):
    """Wait for a true value and return it."""
    deadline = time.monotonic() + seconds
    while not (result := condition()):
        assert time.monotonic() < deadline, "timeout"
        time.sleep(0.2)
    return result


def status(browser) -> str:
    text = browser.find_element("tag name", "body").text
    return next((line for line in text.splitlines() if line.endswith(" ms")), "")


def settled(browser) -> np.ndarray:
    """Return the picture once it no longer changes."""
    until(lambda: status(browser))
    before = None
    while before is None or (before != (now := canvas(browser))).any():
        before = canvas(browser)
        time.sleep(1)
    return now


def labelled(browser, label: str, selector: str):
    """Return the control with this label."""
    rows = browser.find_elements("xpath", f"//*[normalize-space(text())='{label}']/ancestor::*[.//input][1]")
    return next(found for row in rows for found in row.find_elements("css selector", selector))


def press(browser, label: str, key: str, times: int) -> None:
    """Press keys on the slider with this label."""
    slider = labelled(browser, label, "[role=slider]")
    for _ in range(times):
        slider.send_keys(key)


@pytest.fixture
def page(viewer, browser):  # in this order: the browser checks its console before the server stops
    browser.get(viewer.url)
    until(lambda: status(browser))
    return browser


def test_the_page_shows_the_scene_and_a_slider_changes_it(page):
    from selenium.webdriver.common.keys import Keys

    before = settled(page)
    assert before.std() > 5  # not a single color
    press(page, "Exposure (stops)", Keys.ARROW_RIGHT, 15)
    until(lambda: canvas(page).mean() > before.mean() + 5)


def test_a_dimmed_light_darkens_the_picture(page):
    from selenium.webdriver.common.keys import Keys

    before = settled(page).mean()
    press(page, "Light power", Keys.HOME, 1)
    until(lambda: canvas(page).mean() < before - 1)


def test_an_object_is_dragged_by_its_handles(page):
    from selenium.webdriver import ActionChains

    chosen = next(e for e in page.find_elements("css selector", "input") if e.get_attribute("value") == "lamp")
    chosen.click()
    until(lambda: [e for e in page.find_elements("css selector", "[role=option]") if e.text == "peak_1"])[0].click()
    before = settled(page)
    page.execute_script("arguments[0].click()", labelled(page, "Drag in the picture", "input[type=checkbox]"))
    until(lambda: (canvas(page) != before).any())
    handles = (settled(page) != before).any(axis=-1)
    depth = distance_transform_edt(handles)
    row, column = np.unravel_index(depth.argmax(), depth.shape)  # in the middle of a square between the axes
    view = page.find_element("css selector", "canvas")
    x, y = int(column) - handles.shape[1] // 2, int(row) - handles.shape[0] // 2
    elsewhere = ~binary_dilation(handles, iterations=40)
    ActionChains(page).move_to_element_with_offset(view, x, y).click_and_hold().move_by_offset(20, 10).perform()
    try:
        until(lambda: ((canvas(page) != before).any(axis=-1) & elsewhere).any())
    finally:
        ActionChains(page).release().perform()
    assert ((settled(page) != before).any(axis=-1) & elsewhere).any()


def test_visitors_are_independent(page, viewer):
    from selenium.webdriver.common.keys import Keys

    before = settled(page)
    first = page.current_window_handle
    page.switch_to.new_window("window")
    try:
        page.set_window_size(1280, 900)
        page.get(viewer.url)
        mine = settled(page)
        press(page, "Exposure (stops)", Keys.ARROW_RIGHT, 15)
        until(lambda: canvas(page).mean() > mine.mean() + 5)
    finally:
        page.close()
        page.switch_to.window(first)
    assert abs(canvas(page).astype(int) - before).mean() < 1
