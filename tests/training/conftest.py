import dataclasses

import pytest

from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import Dataset, generate


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """The folder of tiny training and validation data in 2-D."""
    root = tmp_path_factory.mktemp("training")
    config = DatasetConfig(scenes=5, cells=8, per_scene=17)
    generate(config, root / "train")
    generate(dataclasses.replace(config, stream="validation", scenes=2), root / "validation")
    return root


@pytest.fixture(scope="session")
def data(folders):
    return Dataset.load(folders / "train")


@pytest.fixture(scope="session")
def validation(folders):
    return Dataset.load(folders / "validation")
