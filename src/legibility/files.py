"""Files that are whole or not there: written under a temporary name, then renamed."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import InvalidInputError, OutputError


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path to write to; on success it becomes `path`, on failure it is removed.

    The temporary name keeps the suffix, so that writers that look at it choose the same format. A
    link is followed, and a device or pipe (/dev/stdout) is written to, not replaced.

    Raises:
        OutputError: the folder cannot be made or the file cannot be written (read-only, full).
    """
    path = Path(path)
    if not path.name or "\0" in str(path):
        raise OutputError(f"cannot write {str(path)!r}: not a file name")
    is_special = os.path.exists(path) and not (path.is_file() or path.is_dir())
    final = path if is_special else Path(os.path.realpath(path))
    folder = Path(tempfile.gettempdir()) if is_special else final.parent
    temporary = folder / f".{secrets.token_hex(8)}{path.suffix}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield temporary
        if is_special:
            with open(temporary, "rb") as source, open(final, "wb") as sink:
                shutil.copyfileobj(source, sink)
        else:
            with open(temporary, "rb") as handle:
                os.fsync(handle.fileno())
            os.replace(temporary, final)
    except OSError as cause:
        raise OutputError(f"cannot write {path}: {cause.strerror or cause}") from cause
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write `content` to `path` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_json(path: str | Path, content: Any) -> None:
    """Write `content` as indented JSON (UTF-8, no NaN) to `path` atomically."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_bytes(path, text.encode())


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def read_text(path: str | Path, what: str, error: type[Exception] = InvalidInputError) -> str:
    """The text of `path`, or `error` naming `what` was looked for."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as cause:
        reason = cause.strerror if isinstance(cause, OSError) else "not a text file"
        raise error(f"cannot read the {what} {path}: {reason}") from cause
