import dataclasses

import pytest

from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import Dataset, generate


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """The folder of tiny training and validation data in 2-D, of any room and observer."""
    root = tmp_path_factory.mktemp("training")
    config = DatasetConfig(scenes=3, views=2, cells=8, per_scene=17, candidates=4096)
    generate(config, root / "train")
    generate(
        dataclasses.replace(config, stream="validation", scenes=2, views=1), root / "validation"
    )
    return root


@pytest.fixture(scope="session")
def data(folders):
    return Dataset.load(folders / "train")


@pytest.fixture(scope="session")
def validation(folders):
    return Dataset.load(folders / "validation")
