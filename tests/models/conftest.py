"""Networks of these tests read their dials off curves that are made once."""

import functools

import pytest
import torch

from legibility.models import dial

torch.set_num_threads(1)  # the models of these tests are too small for more

standard_curves = functools.cache(dial.standard_curves)


@pytest.fixture(autouse=True, scope="module")
def curves_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dial, "standard_curves", standard_curves)
        yield
