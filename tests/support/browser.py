"""Headless Chromium for tests of pages. Import the fixture `browser` in the conftest.py of the folder that needs it."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from importlib.util import find_spec

import numpy as np
import pytest
from PIL import Image

_CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_DRIVER = shutil.which("chromedriver")

requires_chromium = pytest.mark.skipif(
    find_spec("selenium") is None or _CHROMIUM is None or _DRIVER is None,
    reason='no Chromium: apt-get install chromium chromium-driver, pip install "rfpp[dev]"',
)


@pytest.fixture(scope="session")
def _chromium() -> Iterator:
    from selenium.webdriver import Chrome, ChromeOptions, ChromeService

    options = ChromeOptions()
    options.binary_location = _CHROMIUM
    for argument in (
        "--headless=new",
        "--no-sandbox",  # which root and containers cannot have
        "--disable-dev-shm-usage",
        "--window-size=1280,900",
        "--force-device-scale-factor=1",
        "--enable-unsafe-swiftshader",  # WebGL without a GPU
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = Chrome(options, ChromeService(_DRIVER))
    try:
        yield driver
    finally:
        driver.quit()


@pytest.fixture
def browser(_chromium) -> Iterator:
    """A Chromium (selenium.webdriver.Chrome), 1280 × 900; a test whose page has logged an error fails."""
    _chromium.get("about:blank")
    console_errors(_chromium)
    yield _chromium
    assert console_errors(_chromium) == []


def console_errors(browser) -> list[str]:
    """Return errors of the console since the last call."""
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def picture_of(element) -> np.ndarray:
    """[height, width, 3] uint8: the element as it is on screen."""
    return np.asarray(Image.open(io.BytesIO(element.screenshot_as_png)).convert("RGB"))
