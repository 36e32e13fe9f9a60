"""Weights on the Hugging Face Hub: downloaded into its cache, and pushed beside their model card.

Only `config.json`, safetensors and the card travel, so nothing that is downloaded can run code.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..errors import HubError, InvalidInputError

CARD = "README.md"
"""File name of the model card."""

_FILES = ["config.json", "*.safetensors", CARD]

_NAME = re.compile(r"([A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*)(?:@(\S+))?", re.ASCII)

_HUB = "the Hugging Face Hub"


def hub_name(name: str, revision: str | None = None) -> tuple[str, str | None] | None:
    """The repository and the revision of `USER/REPOSITORY` or `USER/REPOSITORY@REVISION`.

    None if `name` is neither.

    Raises:
        InvalidInputError: `name` has one revision and `revision` is another.
    """
    if (match := _NAME.fullmatch(name)) is None:
        return None
    repository, own = match.groups()
    if None not in (own, revision) and own != revision:
        raise InvalidInputError(f"revision must be that of {name}, got {revision!r}")
    return repository, own or revision


def download(repository: str, revision: str | None = None) -> Path:
    """The folder of a repository's weights in the Hub's cache, which is brought up to date.

    Without a connection it is the folder of the last download, if there is one.

    Raises:
        HubError: there is no such repository or revision, or the Hub cannot be reached.
    """
    missing = f"there is neither a folder {repository} nor a repository on {_HUB} that you may read"
    unreachable = (
        f"cannot reach {_HUB}, and {repository} is neither a folder nor in the Hub's cache: "
        "connect to the internet, or give a folder of weights"
    )
    with _errors_of_hub(repository, revision, missing, unreachable):
        folder = _api(None).snapshot_download(repository, revision=revision, allow_patterns=_FILES)
    return Path(folder)


def upload(
    folder: Path,
    repository: str,
    *,
    branch: str | None = None,
    private: bool | None = None,
    token: str | None = None,
) -> str:
    """Push the weights and the card in `folder` in one commit; return the address of the commit.

    The repository is made if it is missing. Weights that it has and `folder` has not are deleted.

    Args:
        folder: of weights.
        repository: `USER/REPOSITORY`.
        branch: to which it is pushed, made if it is missing; the main one if not given.
        private: whether a new repository is private; the account's default if not given.
        token: of an account that may write; that of `hf auth login` or HF_TOKEN if not given.

    Raises:
        HubError: there is no token, or the Hub refuses it or cannot be reached.
        InvalidInputError: `repository` is no such name.
    """
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete, get_token

    if hub_name(repository) != (repository, None):
        raise InvalidInputError(f"repository must be USER/REPOSITORY, got {repository!r}")
    if token is None and get_token() is None:
        raise HubError(
            f"a push to {_HUB} needs a token that may write: call `hf auth login`, set HF_TOKEN, "
            "or give token"
        )
    files = {file.name: file for pattern in _FILES for file in sorted(folder.glob(pattern))}
    missing = f"there is no repository {repository} on {_HUB} to which your token may write"
    unreachable = f"cannot reach {_HUB}: nothing was pushed to {repository}"
    api = _api(token)
    with _errors_of_hub(repository, branch, missing, unreachable):
        api.create_repo(repository, private=private, exist_ok=True)
        if branch is not None:
            api.create_branch(repository, branch=branch, exist_ok=True)
        old = api.list_repo_files(repository, revision=branch)
        operations: list[Any] = [CommitOperationAdd(name, file) for name, file in files.items()]
        operations += [
            CommitOperationDelete(name)
            for name in old
            if name.endswith(".safetensors") and name not in files
        ]
        commit = api.create_commit(
            repository, operations, commit_message="Push weights", revision=branch
        )
    return str(commit.commit_url)


def card_head(
    *, license: str | None = None, tags: Sequence[str] = (), model_index: Sequence[Any] = ()
) -> str:
    """The YAML with which a model card begins, by which the Hub lists the model.

    Args:
        license: of the weights; left out if not given.
        tags: further tags.
        model_index: what was measured, in the Hub's form.
    """
    import yaml

    content = {
        **({"license": license} if license else {}),
        "library_name": "legibility",
        "pipeline_tag": "robotics",
        "tags": ["robotics", "human-robot-interaction", "legibility", "diffusion", *tags],
        **({"model-index": list(model_index)} if model_index else {}),
    }
    text = yaml.safe_dump(
        content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=98
    )
    return f"---\n{text}---\n\n"


def plain_card(repository: str) -> str:
    """The model card of weights without measured metrics."""
    return f"""{card_head()}# {repository.rpartition("/")[2]}

A model of the Legibility Modulator, which plans motions of any legibility. Load it with
`legibility.Modulator.from_pretrained("{repository}")`. How it was trained is in `config.json`; its
metrics were not measured.
"""


def _api(token: str | None) -> Any:
    from huggingface_hub import HfApi

    from .. import __version__

    return HfApi(token=token, library_name="legibility", library_version=__version__)


@contextlib.contextmanager
def _errors_of_hub(
    repository: str, revision: str | None, missing: str, unreachable: str
) -> Iterator[None]:
    """Turn errors of huggingface_hub into one line; those of a disk pass.

    `missing` and `unreachable` are the lines for no such repository and for no connection.
    """
    from huggingface_hub import errors

    # The error of the library that sends requests, which is not the same in all versions.
    http_error: Any = errors.HfHubHTTPError.__bases__[0]
    try:
        yield
    except errors.RevisionNotFoundError as cause:
        raise HubError(
            f"{repository} on {_HUB} has no revision {revision!r}: give one of its branches, tags "
            "or commits"
        ) from cause
    except errors.RepositoryNotFoundError as cause:
        raise HubError(missing) from cause
    except errors.HFValidationError as cause:
        raise InvalidInputError(f"{_HUB} has no repository {repository!r}: {cause}") from cause
    except errors.LocalEntryNotFoundError as cause:
        raise HubError(unreachable) from cause
    except errors.HfHubHTTPError as cause:
        reason = cause.server_message or f"status {cause.response.status_code}"
        raise HubError(f"{_HUB} refuses {repository}: {' '.join(reason.split())}") from cause
    except (http_error, OSError) as cause:
        if isinstance(cause, OSError) and cause.errno is not None:
            raise  # of the disk
        raise HubError(unreachable) from cause
