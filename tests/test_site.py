"""The site: it builds without a warning, nothing in it leads nowhere, and it is read offline."""

import html
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import legibility
from legibility.cli.verbs import VERBS

pytest.importorskip("furo", reason="the extra docs is not installed")

ROOT = Path(__file__).parent.parent
_ANCHOR = re.compile(r'\s(?:id|name)="([^"]+)"')
_LINK = re.compile(r'\s(?:href|src)="([^"]+)"')


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The text of each page by its file."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", str(out)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert not built.returncode, built.stderr
    return {file: file.read_text(encoding="utf-8") for file in out.rglob("*.html")}


def _page(pages, name):
    (text,) = [text for file, text in pages.items() if file.as_posix().endswith(f"/{name}.html")]
    return text


def test_every_link_leads_somewhere(pages):
    anchors = {file: set(_ANCHOR.findall(text)) for file, text in pages.items()}
    for file, text in pages.items():
        for link in map(html.unescape, _LINK.findall(text)):
            url = urlsplit(link)
            if url.scheme:
                continue
            target = (file.parent / unquote(url.path)).resolve() if url.path else file
            assert target.is_file(), f"{file.name}: {link}"
            if url.fragment and target in anchors:
                assert unquote(url.fragment) in anchors[target], f"{file.name}: {link}"


def test_nothing_is_loaded_from_elsewhere(pages):
    for file, text in pages.items():
        loaded = re.findall(r"<(?:script|link|img|iframe|source)\b[^>]*>", text)
        assert not [tag for tag in loaded if re.search(r'="(?:https?:)?//', tag)], file.name


def test_every_public_name_is_described(pages):
    described = set().union(*(_ANCHOR.findall(text) for text in pages.values()))
    for name in legibility.__all__:
        full = f"legibility.{name}"
        assert name == "__version__" or {full, f"module-{full}"} & described, name


def test_every_verb_is_described(pages):
    page = _page(pages, "command-line")
    for verb in VERBS:
        assert f'id="legibility-{verb.replace(" ", "-")}"' in page, verb


def test_equations_are_shown_without_a_script(pages):
    assert _page(pages, "method").count('display="block"') >= 10
