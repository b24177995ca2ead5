"""A headless Chromium for tests of pages, where there is one."""

import contextlib
import os
import shutil
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

#: Software rendering: WebGL works without a graphics card.
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def find_chromium() -> str | None:
    """Return the browser to test with: SLBENCH_CHROMIUM, or one on the path."""
    given = os.environ.get("SLBENCH_CHROMIUM")
    names = [given] if given else ["chromium", "chromium-browser", "google-chrome"]
    return next(filter(None, map(shutil.which, names)), None)


@contextlib.contextmanager
def chromium() -> Iterator:
    """Give a running browser; skip the test where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = find_chromium()
    if path is None:
        pytest.skip("no Chromium: set SLBENCH_CHROMIUM to its path, or put it on the PATH")
    with playwright.sync_playwright() as driver:
        try:
            browser = driver.chromium.launch(executable_path=path, args=ARGUMENTS)
        except playwright.Error as error:
            pytest.skip(f"Chromium at {path} does not start: {str(error).splitlines()[0]}")
        yield browser
        browser.close()


def pixels(png: bytes) -> np.ndarray:
    """Return a screenshot as an array (V, U, 3) of bytes."""
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
