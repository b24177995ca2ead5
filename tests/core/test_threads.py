"""Work in bands: every item once, whatever the number of threads."""

import numpy as np
import pytest

from slbench.core import threads


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 100, 1001])
def test_every_item_is_worked_on_once(monkeypatch, workers, count):
    monkeypatch.setattr(threads, "thread_count", lambda: workers)
    done = np.zeros(count, int)

    def work(first, last):
        done[first:last] += 1

    threads.in_bands(work, count, 10)
    assert (done == 1).all()


def test_what_a_band_raises_is_raised(monkeypatch):
    monkeypatch.setattr(threads, "thread_count", lambda: 2)

    def work(first, last):
        if last == 100:
            raise ValueError("the last band")

    with pytest.raises(ValueError, match="the last band"):
        threads.in_bands(work, 100, 10)
