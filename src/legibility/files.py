"""Files: written whole or not at all, and read strictly.

A leading `~` of a path is the user's home folder. JSON and YAML are read without guessing: repeated
keys and numbers that programs read differently are errors.
"""

import contextlib
import hashlib
import json
import logging
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import InvalidInputError, OutputError

_LOG = logging.getLogger(__name__)

_DECIMAL = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path of the same suffix; it becomes `path`, or is removed on failure.

    A link is followed, and a device or pipe (/dev/stdout) is written to, not replaced.

    Raises:
        OutputError: the folder cannot be made or the file cannot be written (read-only, full).
    """
    path = at_home(path)
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
    else:
        _LOG.info("wrote %s", path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


@contextlib.contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a new folder beside `path`; it becomes `path`, or is removed on failure.

    Raises:
        OutputError: `path` is there already, unless it is an empty folder, or cannot be written.
    """
    path = at_home(path)
    final = Path(os.path.realpath(path))
    temporary = final.parent / f".{secrets.token_hex(8)}"
    try:
        if final.exists() and (not final.is_dir() or any(final.iterdir())):
            raise OutputError(f"cannot write the folder {path}: it is there and not empty")
        temporary.mkdir(parents=True)
        yield temporary
        if final.exists():
            final.rmdir()
        temporary.rename(final)
    except OSError as cause:
        if isinstance(cause, OutputError):
            raise
        raise OutputError(f"cannot write the folder {path}: {cause.strerror or cause}") from cause
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write `content` to `path` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_json(path: str | Path, content: Any) -> None:
    """Write `content` as indented JSON (UTF-8, no NaN) to `path` atomically."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    # Surrogates of a file name that is not UTF-8 are written as JSON escapes.
    write_bytes(path, text.encode(errors="backslashreplace"))


def write_document(path: str | Path, content: Any) -> None:
    """Write `content` as JSON if the path's suffix is .json, as YAML otherwise."""
    if Path(path).suffix.lower() == ".json":
        return write_json(path, content)
    import yaml

    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    return write_bytes(path, text.encode())


def file_hash(path: str | Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def read_text(path: str | Path, what: str, error: type[Exception] = InvalidInputError) -> str:
    """The text of `path`; if unreadable, an `error` that calls the file a `what`."""
    try:
        text = at_home(path).read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as cause:
        reason = cause.strerror if isinstance(cause, OSError) else "not a text file in UTF-8"
        raise error(f"cannot read the {what} {path}: {reason}") from cause
    _LOG.info("read the %s %s", what, path)
    return text


def read_document(path: str | Path, what: str, error: type[Exception] = InvalidInputError) -> Any:
    """The content of a JSON file (.json) or YAML file (any other suffix).

    It refuses a repeated key, an alias of YAML, and a number that YAML 1.1 does not read as decimal
    notation: 010 (octal), 1:30 (base 60), 5e-1 (text).
    """
    form = "JSON" if Path(path).suffix.lower() == ".json" else "YAML"
    text = read_text(path, what, error)
    try:
        if form == "JSON":
            return json.loads(text, object_pairs_hook=_mapping_once)
        return _read_yaml(text)
    except (ValueError, RecursionError) as cause:
        raise error(f"{path} is not valid {form}: {' '.join(str(cause).split())}") from cause


def at_home(path: str | Path) -> Path:
    """`path` with the user's home folder for a leading `~`."""
    return Path(os.path.expanduser(path))


def _mapping_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for key, value in pairs:
        if key in content:
            raise ValueError(f"the key {key!r} is repeated")
        content[key] = value
    return content


def _read_yaml(text: str) -> Any:
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                event = self.peek_event()
                raise _yaml_error(event, f"aliases (*{event.anchor}) are not read")
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            try:
                _mapping_once(
                    [(self.construct_object(key, deep=True), None) for key, _ in node.value]
                )
            except ValueError as cause:
                raise _yaml_error(node, cause) from cause
            return super().construct_mapping(node, deep)

        def construct_scalar(self, node: Any) -> Any:
            if isinstance(node, yaml.ScalarNode) and node.style is None:
                _check_number(node)
            return super().construct_scalar(node)

    try:
        return yaml.load(text, Loader)
    except (yaml.YAMLError, AttributeError, LookupError, TypeError) as cause:
        raise _yaml_error(cause, getattr(cause, "problem", cause)) from cause


def _check_number(node: Any) -> None:
    """Raise unless YAML 1.1 and decimal notation agree whether an unquoted scalar is a number.

    YAML alone reads other bases (0x1F, 1:30) and underscores, decimal notation alone 5e-1 and 08;
    010 is a number in both, but octal in YAML.
    """
    is_number = node.tag.endswith((":int", ":float"))
    is_octal = node.tag.endswith(":int") and re.match("[-+]?0[0-9]", node.value)
    if _DECIMAL.fullmatch(node.value):
        if is_octal or not is_number:
            number = float(node.value)
            hint = f"{number:.12g}" if 1e-4 <= abs(number) < 1e9 else f"{number:.6e}"
            problem = f"YAML does not read {node.value} as a decimal number: write {hint}"
            raise _yaml_error(node, problem)
    elif is_number and not re.search("inf|nan", node.value, re.IGNORECASE):
        raise _yaml_error(node, f"{node.value} is not a decimal number")


def _yaml_error(place: Any, problem: object) -> ValueError:
    """An error with the line of a node, event or error of YAML, if it has one."""
    mark = getattr(place, "problem_mark", None) or getattr(place, "start_mark", None)
    return ValueError(f"line {mark.line + 1}: {problem}" if mark else str(problem))
