"""The networks have the shapes they promise and start where they should."""

import pytest
import torch

from legibility.models.networks import FieldEncoder, FiLMUNet, Residual, SetEncoder, fourier


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("channels", [(8,), (8, 16), (8, 16, 24), (8, 8, 16, 16)])
def test_unet_keeps_the_shape(dim, channels):
    torch.manual_seed(0)
    net = FiLMUNet(7, dim, channels, condition=5)
    found = net(torch.randn(3, 8, 7), torch.randn(3, 5))
    assert found.shape == (3, 8, dim)
    assert len(net.down) == len(net.up) == len(channels) - 1
    assert torch.equal(found, net.outlet.bias.expand(3, 8, dim))  # starts at a constant


def test_every_weight_of_the_unet_counts():
    torch.manual_seed(0)
    net = FiLMUNet(6, 2, (8, 16), condition=5)
    torch.nn.init.normal_(net.outlet.weight)
    net(torch.randn(3, 8, 6), torch.randn(3, 5)).square().sum().backward()
    idle = [n for n, p in net.named_parameters() if p.grad is None or not p.grad.abs().sum()]
    assert idle == []


def test_condition_reaches_the_output():
    torch.manual_seed(0)
    net = FiLMUNet(6, 2, (8, 16), condition=5)
    torch.nn.init.normal_(net.outlet.weight)
    x = torch.randn(1, 8, 6)
    assert not torch.allclose(net(x, torch.zeros(1, 5)), net(x, torch.ones(1, 5)))


def test_rows_of_a_batch_do_not_meet():
    torch.manual_seed(0)
    net, encoder = FiLMUNet(6, 2, (8, 16), condition=5), FieldEncoder(3, 16, 8, 12)
    torch.nn.init.normal_(net.outlet.weight)
    x, condition, image = torch.randn(4, 8, 6), torch.randn(4, 5), torch.randn(4, 3, 16, 16)
    torch.testing.assert_close(net(x[2:3], condition[2:3]), net(x, condition)[2:3])
    torch.testing.assert_close(encoder(image[2:3]), encoder(image)[2:3])


def values(output, inputs, layer):
    """An output, and the gradients of something of it by the inputs and the layer's weights."""
    loss = (output * torch.linspace(-1, 1, output.numel()).view_as(output)).sum()
    return [output, *torch.autograd.grad(loss, [*inputs, *layer.parameters()])]


def test_a_batch_of_one_leaves_the_weights_alone():
    torch.manual_seed(0)
    net, x = FiLMUNet(6, 2, (16, 16, 16, 16), condition=5), torch.randn(1, 8, 6)
    torch.nn.init.normal_(net.outlet.weight)
    before = {name: value.clone() for name, value in net.state_dict().items()}
    condition = torch.randn(1, 5)
    found = net(x, condition)
    found.sum().backward()
    for name, value in net.state_dict().items():
        assert torch.equal(value, before[name]), name
    with torch.no_grad():
        torch.testing.assert_close(net(x, condition), found, atol=1e-5, rtol=1e-5)


def test_unet_in_bfloat16_is_that_in_float32_to_its_rounding():
    torch.manual_seed(0)
    net, x = FiLMUNet(6, 2, (64, 128), condition=5), torch.randn(64, 8, 6)
    torch.nn.init.normal_(net.outlet.weight)
    condition = torch.randn(64, 5)
    expected = values(net(x, condition), [], net)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        output = net(x, condition)
    assert output.dtype == torch.bfloat16
    found = values(output.float(), [], net)
    assert all(each.dtype == torch.float32 for each in found)
    assert (found[0] - expected[0]).norm() < 0.06 * expected[0].norm()
    one, other = (torch.cat([g.flatten() for g in each[1:]]) for each in (found, expected))
    assert (one - other).norm() < 0.06 * other.norm()


@pytest.mark.parametrize("resolution", [8, 16, 32])
def test_encoder(resolution):
    encoder = FieldEncoder(6, resolution, 8, 12)
    assert encoder(torch.randn(2, 6, resolution, resolution)).shape == (2, 12)


def test_a_set_has_no_order_and_no_empty_places():
    torch.manual_seed(0)
    encoder, things = SetEncoder(5, 12), torch.randn(20, 3, 5)
    there = torch.ones(20, 3, dtype=torch.bool)
    found = encoder(things, there)
    torch.testing.assert_close(encoder(things.flip(1), there), found)
    filled = torch.cat([things, torch.randn(20, 4, 5)], dim=1)
    there = torch.arange(7).expand(20, 7) < 3
    torch.testing.assert_close(encoder(filled, there), found)
    assert not torch.allclose(encoder(filled, torch.ones_like(there)), found)


def test_residual_keeps_the_shape():
    assert Residual(6)(torch.randn(2, 3, 6)).shape == (2, 3, 6)


def test_fourier_tells_all_levels_apart():
    levels = torch.linspace(-1, 1, 201)
    found = fourier(levels, 12)
    assert found.shape == (201, 25)
    assert found.abs().max() <= 1 + 1e-6
    gaps = torch.cdist(found, found) + 10 * torch.eye(201)
    assert gaps.min() > 0.05
    torch.testing.assert_close(fourier(torch.zeros(1), 2), torch.tensor([[0.0, 0, 0, 1, 1]]))
