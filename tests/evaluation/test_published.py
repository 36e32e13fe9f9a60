import torch

from legibility.evaluation.published import PublishedDiffuser


def test_has_as_many_parameters_as_published():
    with torch.device("meta"):
        model = PublishedDiffuser()
    assert 72.5e6 < sum(p.numel() for p in model.unet.parameters()) < 72.7e6
    assert 11.1e6 < sum(p.numel() for p in model.encoder.parameters()) < 11.3e6


def test_draws_paths():
    model = PublishedDiffuser(dim=3, channels=(8, 16, 24)).eval()
    drawn = model.sample(2, steps=3)
    assert drawn.shape == (2, 8, 3)
    assert torch.isfinite(drawn).all()
