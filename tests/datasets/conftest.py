"""What tests of data sets share."""

import datasets_small as small
import pytest

from slbench import datasets


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return small.write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="module")
def data(folder):
    return datasets.open_dataset(folder)
