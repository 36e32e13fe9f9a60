"""The settings of the site: `make docs` builds it into build/docs, offline and for offline reading.

Three things are done here and not by hand: the page of the command line is written from the
parser, inline code that names an object of the API links to it, and equations become MathML, which
browsers show without a script.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys

from docutils import nodes
from docutils.utils.math import latex2mathml
from numpy.typing import ArrayLike
from sphinx import addnodes
from sphinx.ext.napoleon.docstring import GoogleDocstring
from sphinx.util.typing import stringify_annotation

import legibility
from legibility.checks import Array
from legibility.cli import main
from legibility.cli.verbs import VERBS

project = "Legibility Modulator"
author = copyright = "Legibility Modulator contributors"
version = release = legibility.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
exclude_patterns = []
nitpicky = True
# Types of others are not looked up, which would need the network, nor are those inside.
nitpick_ignore_regex = [
    ("py:.*", r"(?!legibility\b).*"),
    ("py:.*", r"legibility\.(models|motion\.tracking|envs\.guard|robots\.kinematics)\..*"),
    ("py:.*", r".*\.(Solids|Nearby|Lean)"),
]

html_theme = "furo"
html_title = project
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
_ARRAYS = {"Array": Array, "ArrayLike": ArrayLike}
autodoc_type_aliases = {name: name for name in _ARRAYS}
python_use_unqualified_type_names = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
default_role = "code"

# They are attributes of the package, and documented by these names.
for _name in ("metrics", "labels"):
    sys.modules[f"legibility.{_name}"] = getattr(legibility, _name)


def description(self: GoogleDocstring) -> tuple[str, list[str]]:
    """That of a property, in which a colon does not end a type."""
    return "", type(self)(self._consume_to_end(), self._config).lines()


GoogleDocstring._consume_inline_attribute = description


def verbs() -> str:
    """The help of every verb, as Markdown."""
    parts = []
    for verb in VERBS:
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown):
            main([*verb.split(), "--help"])
        text = re.sub(r"^ *-+ *\n", "", shown.getvalue(), flags=re.MULTILINE)
        parts += [f"## legibility {verb}", f"```text\n{text.strip()}\n```"]
    return "\n\n".join(parts)


def fill_in_verbs(app, docname: str, source: list[str]) -> None:
    """Put the help of the verbs into the page that asks for it."""
    if docname == "command-line":
        os.environ["COLUMNS"] = "88"
        source[0] = source[0].replace("<!-- verbs -->", verbs())


def headings_as_rubrics(app, what, name, obj, options, lines: list[str]) -> None:
    """Read the headings of an environment's docstring, which Gymnasium writes in Markdown."""
    lines[:] = [re.sub(r"^## (.*)$", r".. rubric:: \1", line) for line in lines]
    for i in reversed([i for i, line in enumerate(lines) if line.startswith(".. rubric::")]):
        lines[i : i + 1] = [lines[i], ""]


def name_arrays(app, what, name, obj, options, signature, returned):
    """Write `Array` and `ArrayLike` in signatures, whose definitions fill lines."""
    aliases = {stringify_annotation(kind, "smart"): n for n, kind in _ARRAYS.items()}
    if signature is None:  # a property
        return None
    shown = [signature, returned or ""]
    for long, short in aliases.items():
        shown = [text.replace(long, short) for text in shown]
    return tuple(re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in shown)


def link_code(app, doctree: nodes.document, docname: str) -> None:
    """Link inline code that names an object of the API to it, such as `lg.Scene` or `Path.timed`.

    A name without a dot must be that of a class or a function, and only one may have it.
    """
    named = names_of_objects(app)
    for node in list(doctree.findall(nodes.literal)):
        inside = (nodes.reference, nodes.title, addnodes.desc_signature)
        if any(isinstance(parent, inside) for parent in ancestors(node)):
            continue
        name, call, _ = node.astext().partition("(")
        if call and not re.search(r"[._]", name):  # `Box(…)` may be somebody else's
            continue
        if (entry := named.get(re.sub(r"^(lg|legibility)\.", "", name))) is not None:
            link = nodes.reference("", "", internal=True, reftitle=entry[0])
            link["refuri"] = app.builder.get_relative_uri(docname, entry[1]) + "#" + entry[2]
            node.replace_self(link)
            link += node


def names_of_objects(app) -> dict[str, tuple[str, str, str]]:
    """Full name, page and anchor of the objects of the API, by the names that mean one of them."""
    found: dict[str, set[tuple[str, str, str]]] = {}
    for full, entry in app.env.get_domain("py").objects.items():
        words = full.removeprefix("legibility.").split(".")
        for i, _ in enumerate(words):
            name = ".".join(words[i:])
            if "." in name or entry.objtype in ("class", "exception", "function"):
                found.setdefault(name, set()).add((entry.node_id, entry.docname, entry.node_id))
    return {name: places.pop() for name, places in found.items() if len(places) == 1}


def ancestors(node: nodes.Node):
    """The nodes around a node."""
    while (node := node.parent) is not None:
        yield node


def source_of(app, module: str, name: str) -> str | None:
    """The module that holds the source of an object: that of its class, if it is of one."""
    outer = getattr(sys.modules[module], name.partition(".")[0], None)
    return getattr(outer, "__module__", None)


def visit_math(self, node: nodes.math) -> None:
    """Write an equation in a line as MathML."""
    self.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def visit_math_block(self, node: nodes.math_block) -> None:
    """Write a displayed equation as MathML."""
    equation = latex2mathml.tex2mathml(node.astext(), as_block=True)
    self.body.append(f'<div class="math">{equation}</div>')
    raise nodes.SkipNode


def setup(app) -> None:
    app.connect("source-read", fill_in_verbs)
    app.connect("autodoc-process-docstring", headings_as_rubrics)
    app.connect("autodoc-process-signature", name_arrays)
    app.connect("doctree-resolved", link_code)
    app.connect("viewcode-follow-imported", source_of)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
