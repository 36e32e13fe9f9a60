import torch
from torch import nn

from legibility.evaluation.machine import forward_cost, limits, machine_facts, operations
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.path_diffuser import PathDiffuser


def test_operations_of_known_layers():
    linear = nn.Linear(3, 5)
    found, flops = operations(lambda: linear(torch.ones(7, 3)))
    assert found.shape == (7, 5)
    assert flops == 2 * 7 * 3 * 5
    convolution = nn.Conv1d(4, 6, 3, padding=1)
    assert operations(lambda: convolution(torch.ones(2, 4, 8)))[1] == 2 * 2 * 8 * 4 * 6 * 3


def test_cost_of_a_forward():
    config = PathDiffuserConfig(channels=(8, 16), condition=16, encoder_width=8, resolution=16)
    model = PathDiffuser(config).eval()
    one, two, three = (forward_cost(model, batch) for batch in (1, 2, 3))
    # The scene is encoded once, each path costs the same.
    assert three["flops"] - two["flops"] == two["flops"] - one["flops"] > 0
    assert three["bytes"] - two["bytes"] == 4 * (1 + 2 * 8 * 2)
    assert one["bytes"] > 4 * sum(p.numel() for p in model.parameters())


def test_machine():
    facts = machine_facts(torch.device("cpu"))
    assert facts["cores"] >= 1
    assert facts["cpu"]
    assert facts["threads"] == torch.get_num_threads()
    assert all(work()[0] > 0 for work in limits(torch.device("cpu")).values())
