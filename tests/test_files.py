"""Files are whole or not there."""

import errno
import json
import os

import numpy as np
import pytest

from legibility.errors import InvalidInputError, InvalidSceneError, OutputError
from legibility.files import atomic_path, read_document, read_text, write_bytes, write_json


def everything(folder):
    return sorted(path.name for path in folder.rglob("*"))


def break_off(path, failure):
    with atomic_path(path) as temporary:
        temporary.write_text("half of")
        raise failure("stop")


def test_write_makes_folders_and_leaves_only_the_file(tmp_path):
    write_bytes(tmp_path / "a" / "b" / "c.bin", b"content")
    assert (tmp_path / "a" / "b" / "c.bin").read_bytes() == b"content"
    assert everything(tmp_path) == ["a", "b", "c.bin"]


@pytest.mark.parametrize("failure", [RuntimeError, OSError, KeyboardInterrupt])
def test_failing_writer_leaves_nothing(tmp_path, failure):
    with pytest.raises((failure, OutputError)):
        break_off(tmp_path / "out.txt", failure)
    assert everything(tmp_path) == []


def test_failing_writer_keeps_the_old_file(tmp_path):
    path = tmp_path / "out.json"
    write_json(path, {"old": 1})
    with pytest.raises(RuntimeError):
        break_off(path, RuntimeError)
    assert json.loads(path.read_text()) == {"old": 1}
    assert everything(tmp_path) == ["out.json"]


def test_old_file_stands_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "out.txt"
    write_bytes(path, b"old")
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old"
        assert temporary.parent == path.parent
        assert temporary.suffix == path.suffix
    assert path.read_bytes() == b"new"


def test_writer_that_writes_nothing(tmp_path):
    with pytest.raises(OutputError, match="cannot write"), atomic_path(tmp_path / "out.txt"):
        pass
    assert everything(tmp_path) == []


def test_parent_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot write .*out\.txt: "):
        write_bytes(tmp_path / "file" / "out.txt", b"x")
    assert everything(tmp_path) == ["file"]


def test_target_that_is_a_folder(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="cannot write"):
        write_bytes(tmp_path / "folder", b"x")
    assert everything(tmp_path) == ["folder"]


@pytest.mark.parametrize("name", ["", ".", "/", "a\0b", "n" * 5000])
def test_names_that_no_file_can_have(name):
    with pytest.raises(OutputError, match="cannot write"):
        write_bytes(name, b"x")


def test_longest_name_that_a_file_can_have(tmp_path):
    write_bytes(tmp_path / ("n" * 251 + ".txt"), b"x")
    assert everything(tmp_path) == ["n" * 251 + ".txt"]


def test_full_disk(tmp_path, monkeypatch):
    def full(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_bytes(tmp_path / "out.bin", b"old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match=r"cannot write .*out\.bin: No space left"):
        write_bytes(tmp_path / "out.bin", b"new")
    assert (tmp_path / "out.bin").read_bytes() == b"old"
    assert everything(tmp_path) == ["out.bin"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
def test_pipe_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with atomic_path(pipe) as temporary:
            assert everything(tmp_path) == ["pipe"]
            temporary.write_bytes(b"content")
            assert temporary.parent != tmp_path
        assert os.read(reader, 100) == b"content"
    finally:
        os.close(reader)
    assert pipe.is_fifo()


def test_link_is_followed(tmp_path):
    (tmp_path / "real").mkdir()
    write_bytes(tmp_path / "real" / "file", b"old")
    link = tmp_path / "link"
    try:
        link.symlink_to(tmp_path / "real" / "file")
    except OSError:
        pytest.skip("no links on this system")
    write_bytes(link, b"new")
    assert link.is_symlink()
    assert (tmp_path / "real" / "file").read_bytes() == b"new"


def test_json_round_trip(tmp_path):
    content = {"σ": 0.1 + 0.2, "list": [1, None, "é"], "nested": {"x": -1e-300}}
    write_json(tmp_path / "x.json", content)
    assert json.loads(read_text(tmp_path / "x.json", "file")) == content


@pytest.mark.parametrize("content", [{"x": np.nan}, {"x": float("inf")}, {"x": object()}])
def test_json_that_is_not_json_is_never_written(tmp_path, content):
    with pytest.raises((ValueError, TypeError)):
        write_json(tmp_path / "x.json", content)
    assert everything(tmp_path) == []


def test_read_text_ignores_the_byte_order_mark(tmp_path):
    (tmp_path / "x").write_text("σ = 1", encoding="utf-8-sig")
    assert read_text(tmp_path / "x", "file") == "σ = 1"


@pytest.mark.parametrize(
    ("name", "reason"), [("absent", "No such file"), ("", "directory"), ("binary", "not a text")]
)
def test_read_text_names_what_was_looked_for(tmp_path, name, reason):
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidSceneError, match=f"cannot read the scene file .*{reason}"):
        read_text(tmp_path / name, "scene file", InvalidSceneError)


def test_read_text_of_an_impossible_name():
    with pytest.raises(InvalidInputError, match="cannot read the file"):
        read_text("a\0b", "file")


YAML = {
    "5e-1": ("line 2: YAML does not read 5e-1 as a decimal number: write 0.5", "x: 1\ny: 5e-1"),
    "exponent without a sign": ("write 1500", "y: 1.5e3"),
    "tiny": (r"does not read 5e-12 .*: write 5\.000000e-12", "y: [5e-12]"),
    "octal": ("does not read 010 as a decimal number: write 10", "x: 010"),
    "nearly octal": ("does not read 08 .*: write 8", "x: 08"),
    "sexagesimal": ("line 1: 1:30 is not a decimal number", "x: 1:30"),
    "hexadecimal": ("0x1F is not a decimal number", "x: 0x1F"),
    "underscores": ("1_000 is not a decimal number", "x: 1_000"),
    "repeated key": ("line 1: the key 'x' is repeated", "x: 1\ny: 2\nx: 1"),
    "repeated key within": ("line 2: the key 'b' is repeated", "y: 2\nx: {b: 1, b: 1}"),
    "alias": (r"line 2: aliases \(\*a\) are not read", "x: &a [1]\ny: *a"),
    "tab": (r"line 2: found character '\\t'", "x:\n\t- 1"),
    "open list": ("line 1: expected", "x: [1"),
    "two documents": ("line 3: ", "---\nx: 1\n---\nx: 1"),
    "control characters": ("unacceptable character", "x: \x07"),
    "unhashable key": ("unhashable", "? [1]\n: 2"),
}


@pytest.mark.parametrize(("message", "text"), YAML.values(), ids=YAML)
def test_yaml_that_is_refused(message, text, tmp_path):
    (tmp_path / "x.yaml").write_text(text)
    with pytest.raises(
        InvalidSceneError, match=rf"x\.yaml is not valid YAML: .*{message}"
    ) as caught:
        read_document(tmp_path / "x.yaml", "file", InvalidSceneError)
    assert "\n" not in str(caught.value)


def test_yaml_that_is_read(tmp_path):
    text = (
        "a: [0, -1, +2, 0.5, .5, 5., 5.0e-1, 1.5e+3, -0.0, 00.5]\nb: [.inf, '5e-1', text, yes, ~]\n"
    )
    (tmp_path / "x.yml").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert read_document(tmp_path / "x.yml", "file") == {
        "a": [0, -1, 2, 0.5, 0.5, 5, 0.5, 1500, 0, 0.5],
        "b": [float("inf"), "5e-1", "text", True, None],
    }


def test_a_bomb_of_aliases_is_refused_at_once(tmp_path):
    lines = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    (tmp_path / "x.yaml").write_text("a0: &a0 [x]\n" + "\n".join(lines))
    with pytest.raises(InvalidInputError, match="aliases"):
        read_document(tmp_path / "x.yaml", "file")


@pytest.mark.parametrize(
    ("text", "message"),
    [('{"x": 1, "x": 1}', "the key 'x' is repeated"), ("", "Expecting value"), ("[" * 10**5, "")],
)
def test_json_that_is_refused(text, message, tmp_path):
    (tmp_path / "x.JSON").write_text(text)
    with pytest.raises(InvalidInputError, match=rf"x\.JSON is not valid JSON: .*{message}"):
        read_document(tmp_path / "x.JSON", "file")


def test_json_holds_a_file_name_that_is_no_utf8(tmp_path):
    name = os.fsdecode(b"caf\xe9")
    write_json(tmp_path / "x.json", {"name": name})
    assert json.loads((tmp_path / "x.json").read_text(encoding="utf-8")) == {"name": name}


def test_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    write_bytes("~/x.txt", b"here")
    assert (tmp_path / "x.txt").read_bytes() == b"here"
    assert read_text("~/x.txt", "file") == "here"
