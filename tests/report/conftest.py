"""What the report's tests share."""

import pytest
from browsers import chromium


@pytest.fixture(scope="module")
def browser():
    """One headless Chromium for all tests of a module; skips where there is none."""
    with chromium() as running:
        yield running
