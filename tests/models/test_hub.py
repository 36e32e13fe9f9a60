"""Weights travel over a Hub and come back as they were, or there is one clear line."""

import pytest
import torch
import yaml
from hub import TOKEN, fake_hub

from legibility.errors import CheckpointError, HubError, InvalidInputError
from legibility.models.configuration import PathDiffuserConfig, PathPolicyConfig
from legibility.models.hub import card_head, hub_name, plain_card
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.path_policy import PathPolicy
from legibility.models.pretrained import pretrained_folder
from legibility.modulator import Modulator

TINY = {"channels": (8, 16), "condition": 16}
MINE = "ada/my-model"


def model(seed=0, **more):
    """A tiny untrained modulator of both stages."""
    torch.manual_seed(seed)
    stages = (
        PathDiffuser(PathDiffuserConfig(**TINY, encoder_width=8, resolution=16)),
        PathPolicy(PathPolicyConfig(**TINY)),
    )
    for stage in stages:
        for parameter in stage.parameters():
            torch.nn.init.normal_(parameter)
    return Modulator(*stages, **more)


def assert_equal(one, other):
    """Raise unless both stages of two modulators are equal in float16."""
    for stage in ("path_diffuser", "path_policy"):
        state, again = (getattr(m, stage).state_dict() for m in (one, other))
        assert all(torch.equal(state[n].half(), again[n].half()) for n in state.keys() | again)


def line(error):
    """The message of an error, which is one line."""
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.fixture
def hub(monkeypatch, tmp_path):
    with fake_hub(monkeypatch, tmp_path / "cache") as server:
        monkeypatch.chdir(tmp_path)
        yield server


class TestPushAndLoad:
    def test_what_was_pushed_is_loaded(self, hub):
        pushed = model()
        address = pushed.push_to_hub(MINE)
        assert address.startswith(f"{hub.url}/{MINE}/commit/")
        assert sorted(hub.files(MINE)) == [
            ".gitattributes", "README.md", "config.json", "path.safetensors", "policy.safetensors"
        ]  # fmt: skip
        assert len(hub.repositories[MINE]["main"]) == 2, "one commit after that of the repository"
        found = Modulator.from_pretrained(MINE)
        assert found.name == MINE
        assert_equal(found, pushed)
        card = hub.files(MINE)["README.md"].decode()
        assert card == found.card
        assert "pipeline_tag: robotics" in card
        assert f'from_pretrained("{MINE}")' in card

    def test_a_second_push_is_what_is_loaded_next(self, hub):
        model().push_to_hub(MINE)
        Modulator.from_pretrained(MINE)
        model(1).push_to_hub(MINE)
        assert_equal(Modulator.from_pretrained(MINE), model(1))

    def test_revisions(self, hub):
        model().push_to_hub(MINE)
        model(1).push_to_hub(MINE, branch="v1")
        commit = model(2).push_to_hub(MINE, branch="v1").rpartition("/")[2]
        assert_equal(Modulator.from_pretrained(MINE), model())
        for found in (
            Modulator.from_pretrained(MINE, revision="v1"),
            Modulator.from_pretrained(f"{MINE}@v1"),
            Modulator.from_pretrained(f"{MINE}@{commit}"),
            Modulator.from_pretrained(f"{MINE}@v1", revision="v1"),
        ):
            assert_equal(found, model(2))

    def test_a_stage_that_is_gone_is_deleted(self, hub):
        whole = model()
        whole.push_to_hub(MINE)
        Modulator(whole.path_diffuser).push_to_hub(MINE)
        assert "policy.safetensors" not in hub.files(MINE)
        with pytest.raises(CheckpointError, match=f"{MINE} has no stage 2 .*legibility train"):
            Modulator.from_pretrained(MINE).stage_2()

    def test_nothing_is_downloaded_that_could_run(self, hub):
        model().push_to_hub(MINE)
        strange = {"model.pkl": b"x", "modeling.py": b"x", "sub/config.json": b"{}"}
        hub.files(MINE).update(strange)
        names = {file.name for file in pretrained_folder(MINE).iterdir()}
        assert names == {"README.md", "config.json", "path.safetensors", "policy.safetensors"}

    def test_a_shipped_card_has_its_metrics_as_metadata(self, hub):
        from huggingface_hub import ModelCard

        Modulator.from_pretrained("block-reach-2d").push_to_hub(MINE)
        text = hub.files(MINE)["README.md"].decode()
        card = ModelCard(text)
        assert card.data.pipeline_tag == "robotics"
        assert card.data.library_name == "legibility"
        found = [(r.metric_type, r.dataset_config, r.metric_value) for r in card.data.eval_results]
        assert {regime for _, regime, _ in found} >= {"dragan", "all"}
        assert {"spearmanr", "mae", "success"} <= {metric for metric, _, _ in found}
        assert all(isinstance(value, float) for _, _, value in found)
        assert f'from_pretrained("{MINE}")' in text
        assert 'from_pretrained("block-reach-2d")' not in text

    def test_the_card_stays_with_the_weights(self, tmp_path):
        model(card="# Mine\n").save_pretrained(tmp_path / "mine")
        assert Modulator.from_pretrained(tmp_path / "mine").card == "# Mine\n"
        model().save_pretrained(tmp_path / "plain")
        assert Modulator.from_pretrained(tmp_path / "plain").card is None


class TestOffline:
    @pytest.fixture
    def offline(self, hub, monkeypatch):
        """What was downloaded before is in the cache."""
        from huggingface_hub import constants

        model().push_to_hub(MINE)
        Modulator.from_pretrained(MINE)
        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)

    def test_the_cache_is_used(self, offline):
        assert_equal(Modulator.from_pretrained(MINE), model())

    @pytest.mark.parametrize("name", ["ada/another", f"{MINE}@v2"])
    def test_what_is_not_there_is_one_line(self, offline, name):
        with pytest.raises(HubError) as error:
            Modulator.from_pretrained(name)
        repository = name.partition("@")[0]
        assert f"cannot reach the Hugging Face Hub, and {repository} is neither" in line(error)

    def test_a_push(self, offline):
        with pytest.raises(HubError) as error:
            model().push_to_hub(MINE)
        assert "cannot reach the Hugging Face Hub: nothing was pushed" in line(error)

    def test_nobody_answers(self, hub):
        hub.shutdown()
        hub.server_close()
        with pytest.raises(HubError) as error:
            Modulator.from_pretrained(MINE)
        assert "cannot reach" in line(error)
        with pytest.raises(HubError) as error:
            model().push_to_hub(MINE)
        assert "nothing was pushed" in line(error)


class TestRefuses:
    def test_no_repository(self, hub):
        with pytest.raises(HubError) as error:
            Modulator.from_pretrained("runs/weigths")
        assert "neither a folder runs/weigths nor a repository" in line(error)

    def test_no_revision(self, hub):
        model().push_to_hub(MINE)
        for arguments in ({"revision": "v9"}, {"revision": "a/b"}):
            with pytest.raises(HubError) as error:
                Modulator.from_pretrained(MINE, **arguments)
            assert f"{MINE} on the Hugging Face Hub has no revision" in line(error)
            assert repr(arguments["revision"]) in line(error)

    def test_a_repository_of_others(self, hub):
        hub.repositories[MINE] = {"main": [{"model.safetensors": b"x"}]}
        with pytest.raises(CheckpointError, match="cannot read the model configuration"):
            Modulator.from_pretrained(MINE)

    def test_revision_of_what_is_here(self, hub, tmp_path):
        model().save_pretrained(tmp_path / "a" / "b")
        for name in ("block-reach-2d", "a/b"):
            with pytest.raises(InvalidInputError, match=f"but {name} is here, got 'v1'"):
                Modulator.from_pretrained(name, revision="v1")
            with pytest.raises(InvalidInputError, match=f"but {name} is here, got 'v1'"):
                Modulator.from_pretrained(f"{name}@v1")
        assert not hub.requests

    def test_two_revisions(self, hub):
        with pytest.raises(
            InvalidInputError, match=f"revision must be that of {MINE}@v1, got 'v2'"
        ):
            Modulator.from_pretrained(f"{MINE}@v1", revision="v2")

    def test_no_token(self, hub, monkeypatch):
        monkeypatch.delenv("HF_TOKEN")
        with pytest.raises(HubError) as error:
            model().push_to_hub(MINE)
        assert "needs a token that may write: call `hf auth login`" in line(error)
        assert not hub.requests
        model().push_to_hub(MINE, token=TOKEN)
        assert "path.safetensors" in hub.files(MINE)

    def test_another_token(self, hub):
        with pytest.raises(HubError) as error:
            model().push_to_hub(MINE, token="hf_of_somebody")
        assert "refuses ada/my-model: Invalid credentials" in line(error)
        assert MINE not in hub.repositories

    @pytest.mark.parametrize("name", ["mine", "a/b/c", "a/b@v1", "/a", "a/", ""])
    def test_a_name_that_is_none(self, hub, name):
        with pytest.raises(InvalidInputError, match="repository must be USER/REPOSITORY, got"):
            model().push_to_hub(name)
        assert not hub.requests

    def test_a_name_that_the_hub_does_not_take(self, hub):
        with pytest.raises(InvalidInputError, match="has no repository 'a/b--c'"):
            Modulator.from_pretrained("a/b--c")


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("ada/my-model", ("ada/my-model", None)),
        ("ada/my.model_2@v1", ("ada/my.model_2", "v1")),
        ("ada/m@refs/pr/1", ("ada/m", "refs/pr/1")),
        ("block-reach-2d", None),
        ("./a", None),
        ("../a/b", None),
        ("~/a", None),
        ("/a/b", None),
        ("a/b/c", None),
        ("ada/m@", None),
        ("a/b\n", None),
    ],
)
def test_names(name, found):
    assert hub_name(name) == found


def test_heads_of_cards():
    head = yaml.safe_load(plain_card(MINE).split("---")[1])
    assert head["pipeline_tag"] == "robotics"
    assert "model-index" not in head
    text = card_head(license="mit", tags=["baseline"], model_index=[{"name": "ℓ"}])
    head = yaml.safe_load(text.split("---")[1])
    assert list(head) == ["license", "library_name", "pipeline_tag", "tags", "model-index"]
    assert head["tags"][-1] == "baseline"
    assert head["model-index"] == [{"name": "ℓ"}]
