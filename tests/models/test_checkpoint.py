"""Tensors come back bit for bit, or there is one clear error."""

import json

import pytest
import torch
from safetensors.torch import save
from torch import nn

from legibility.errors import CheckpointError, OutputError
from legibility.models.checkpoint import load_state, load_tensors, save_tensors


@pytest.fixture
def tensors():
    generator = torch.Generator().manual_seed(0)
    return {
        "weight": torch.randn(3, 5, generator=generator),
        "transposed": torch.randn(4, 2, generator=generator).T,
        "half": torch.randn(7, generator=generator).to(torch.bfloat16),
        "double": torch.tensor([1e-300, -0.0, 1 / 3], dtype=torch.float64),
        "step": torch.tensor(41),
        "empty": torch.zeros(0, 3),
    }


@pytest.fixture
def module():
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4))


def test_round_trip_is_exact(tmp_path, tensors):
    header = {"config": {"σ": 0.15, "channels": [1, 2]}, "step": 3}
    save_tensors(tmp_path / "a" / "x.safetensors", tensors, header)
    found, read = load_tensors(tmp_path / "a" / "x.safetensors")
    assert read == header
    assert found.keys() == tensors.keys()
    for name, tensor in tensors.items():
        assert found[name].dtype == tensor.dtype
        assert torch.equal(found[name], tensor)


def test_same_bytes_in_any_order(tmp_path, tensors):
    save_tensors(tmp_path / "one", tensors, {"a": 1, "b": 2})
    save_tensors(tmp_path / "two", dict(reversed(tensors.items())), {"a": 1, "b": 2})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_without_a_header(tmp_path, tensors):
    save_tensors(tmp_path / "x", tensors)
    assert load_tensors(tmp_path / "x")[1] is None
    (tmp_path / "y").write_bytes(save({"weight": torch.ones(2)}))
    assert load_tensors(tmp_path / "y")[1] is None


def test_parameters_need_no_detaching(tmp_path, module):
    save_tensors(tmp_path / "x", dict(module.named_parameters()))
    assert not load_tensors(tmp_path / "x")[0]["0.weight"].requires_grad


def test_failed_write_leaves_the_old_file(tmp_path, tensors, monkeypatch):
    path = tmp_path / "x.safetensors"
    save_tensors(path, tensors)
    before = path.read_bytes()

    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OutputError, match="No space left"):
        save_tensors(path, {"weight": torch.zeros(9)})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.safetensors"]


def test_missing_file(tmp_path):
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(CheckpointError, match="there are no weights at"):
            load_tensors(path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.99])
def test_truncated_file(tmp_path, tensors, share):
    path = tmp_path / "x"
    save_tensors(path, tensors)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(CheckpointError, match="is corrupted or not a safetensors file"):
        load_tensors(path)


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 pickled", b"\xff" * 100, b"{}", b"\x02\0\0\0\0\0\0\0[]"]
)
def test_other_file(tmp_path, content):
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(CheckpointError):
        load_tensors(tmp_path / "x")


@pytest.mark.parametrize("position", range(0, 60, 7))
def test_changed_head(tmp_path, tensors, position):
    """A changed byte of the description is refused, or it changes no more than a name."""
    path = tmp_path / "x"
    save_tensors(path, tensors, {"a": 1})
    content = bytearray(path.read_bytes())
    content[position] ^= 0x80
    path.write_bytes(content)
    with pytest.raises(CheckpointError):
        load_tensors(path)


def test_header_that_is_not_json(tmp_path):
    (tmp_path / "x").write_bytes(save({"a": torch.ones(1)}, metadata={"header": "{"}))
    with pytest.raises(CheckpointError, match="corrupted"):
        load_tensors(tmp_path / "x")


class TestLoadState:
    def test_loads_every_tensor(self, module):
        wanted = {k: torch.full_like(v, 2) for k, v in module.state_dict().items()}
        load_state(module, wanted, "file")
        for name, tensor in module.state_dict().items():
            assert torch.equal(tensor, wanted[name])

    def spoiled(self, module, **changes):
        state = {**module.state_dict(), **changes}
        return {name: tensor for name, tensor in state.items() if tensor is not None}

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"0.weight": None}, r"file: missing tensors \['0.weight'\]"),
            ({"2.weight": torch.ones(1)}, r"unknown \['2.weight'\]"),
            (
                {"0.weight": torch.ones(4, 4)},
                r"0.weight has shape \(4, 4\), the model's is \(4, 3\)",
            ),
            ({"0.weight": torch.ones(12)}, "0.weight has shape"),
            ({"0.bias": torch.full((4,), torch.nan)}, "0.bias is not finite"),
            ({"1.running_var": torch.full((4,), torch.inf)}, "1.running_var is not finite"),
        ],
    )
    def test_refuses_and_changes_nothing(self, module, change, message):
        before = json.dumps({k: v.tolist() for k, v in module.state_dict().items()})
        with pytest.raises(CheckpointError, match=message):
            load_state(module, self.spoiled(module, **change), "file")
        assert json.dumps({k: v.tolist() for k, v in module.state_dict().items()}) == before

    def test_nothing_at_all(self, module):
        with pytest.raises(CheckpointError, match="missing tensors"):
            load_state(module, {}, "file")
