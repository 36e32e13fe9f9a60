"""Tables on disk in Parquet shards: the same bytes for any number of workers, resumed, verified.

A folder holds a manifest and shards. A shard is written atomically and carries its configuration,
so an interrupted run resumes.
"""

import hashlib
import io
import json
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..errors import DatasetError
from ..files import file_hash, read_text, write_bytes, write_json
from ..parallel import pool

_LOG = logging.getLogger(__name__)

SHARD = 64
"""Scenes in a shard."""

ShardProgress = Callable[[int, int], None]
T = TypeVar("T")

_FORMAT = 1
_CONFIG = b"legibility.config"


def shard_bytes(rows: Sequence[dict[str, Any]], config: dict[str, Any]) -> bytes:
    """A shard of `rows` of a configuration."""
    columns = {name: pa.array([row[name] for row in rows]) for name in rows[0]}
    table = pa.table(columns).replace_schema_metadata({_CONFIG: _canonical(config)})
    with io.BytesIO() as buffer:
        pq.write_table(table, buffer, compression="zstd", write_page_checksum=True)
        return buffer.getvalue()


def make_shards(
    folder: Path,
    manifest: str,
    config: dict[str, Any],
    names: Sequence[str],
    make: Callable[[Any], bytes],
    counts: dict[str, int],
    *,
    source: Callable[[int], Any] = lambda number: number,
    workers: int = 1,
    cluster: str | None = None,
    progress: ShardProgress = lambda done, total: None,
) -> None:
    """Make the shards that are missing and the manifest.

    Args:
        config: plain values that fix the bytes together with the code.
        names: of the shards' files.
        make: a shard's bytes from its source. It runs in other processes, and the bytes are written
            here, so no folder is shared (a shard is about 1 MB).
        counts: numbers of items, for the manifest.
        source: of shard i, read here; its number if not given.
        workers, cluster: see `pool`.

    Raises:
        DatasetError: the folder holds shards of another configuration.
    """
    if (folder / manifest).exists():
        old = _read_manifest(folder, manifest)
        if old["config"] != config:
            raise DatasetError(
                f"{folder} holds a dataset of another configuration; choose another folder"
            )
        if old["complete"]:
            changed = _changed(folder, old["shards"])
            if not changed:
                return
            for path in changed:
                path.unlink(missing_ok=True)
    content = {"format": _FORMAT, "config": config, "complete": False}
    with pool(workers, cluster) as run:
        write_json(folder / manifest, content)
        for leftover in folder.glob(".*.parquet"):  # of a run that was killed
            leftover.unlink()
        missing = [i for i, name in enumerate(names) if not _is_whole(folder / name, config)]
        done = len(names) - len(missing)
        progress(done, len(names))
        for index, shard in run(make, [source(i) for i in missing]):
            write_bytes(folder / names[missing[index]], shard)
            done += 1
            progress(done, len(names))
    shards = [{"name": n, "sha256": file_hash(folder / n)} for n in names]
    write_json(folder / manifest, {**content, "complete": True, "counts": counts, "shards": shards})


def read_shards(
    folder: Path, manifest: str, again: str, build: Callable[[dict[str, Any], str, pa.Table], T]
) -> T:
    """Build an object of the configuration, the digest over all shards, and their rows.

    Args:
        folder: of the shards, every hash of which is checked.
        manifest: its file name.
        again: the command that completes the shards.
        build: from the three to the object; its errors mean that they do not fit together.

    Raises:
        DatasetError: the shards are missing, incomplete or changed since they were written.
    """
    content = _read_manifest(folder, manifest)
    if not content["complete"]:
        raise DatasetError(f"{folder} is not complete; run the same `{again}` again")
    try:
        shards = content["shards"]
        for path in _changed(folder, shards):
            raise DatasetError(f"{path} is missing or not as it was written")
        digest = hashlib.sha256("".join(shard["sha256"] for shard in shards).encode())
        table = pa.concat_tables([pq.read_table(folder / shard["name"]) for shard in shards])
        _LOG.info("read %d rows in %d shards of %s", len(table), len(shards), folder)
        return build(content["config"], digest.hexdigest(), table.combine_chunks())
    except (LookupError, TypeError, ValueError, pa.ArrowException) as cause:
        raise DatasetError(f"{folder} has a manifest that does not fit its shards") from cause


def flat(column: pa.ChunkedArray) -> np.ndarray:
    """All numbers of a list column, one after another."""
    return column.combine_chunks().flatten().to_numpy(zero_copy_only=False)


def _read_manifest(folder: Path, manifest: str) -> dict[str, Any]:
    """The manifest, checked for its form."""
    text = read_text(folder / manifest, "dataset manifest", DatasetError)
    try:
        content = json.loads(text)
        written, _, _ = (content[key] for key in ("format", "config", "complete"))
    except (LookupError, TypeError, ValueError) as cause:
        raise DatasetError(f"{folder / manifest} is not a dataset manifest: {cause!r}") from cause
    if written != _FORMAT:
        raise DatasetError(f"{folder} has format {written}; this version reads {_FORMAT}")
    return content


def _canonical(config: dict[str, Any]) -> bytes:
    return json.dumps(config, sort_keys=True).encode()


def _changed(folder: Path, shards: Sequence[dict[str, str]]) -> list[Path]:
    """The shards of a manifest that are missing or have another hash."""
    hashes = {folder / shard["name"]: shard["sha256"] for shard in shards}
    return [path for path, old in hashes.items() if not path.is_file() or file_hash(path) != old]


def _is_whole(path: Path, config: dict[str, Any]) -> bool:
    """Whether `path` is a readable shard of `config`, from which a run may resume."""
    try:
        metadata = pq.read_table(path, page_checksum_verification=True).schema.metadata or {}
    except (OSError, pa.ArrowException):
        return False
    return metadata.get(_CONFIG) == _canonical(config)
