"""What Sphinx makes the site with; ``python docs/website.py`` puts its sources together first.

No page asks anything of another machine: fonts are those of the reader's system, formulas are MathML, which browsers
draw themselves, and the search runs in the page, with the pages' texts in a file of their own.
"""

from __future__ import annotations

import json
import re
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.writers.html5 import HTML5Translator

project = "hexjet-cosim"
author = "The hexjet-cosim authors"
copyright = author
release = version = version_of("hexjet-cosim")

extensions = ["myst_parser"]
root_doc = "index"
source_suffix = {".md": "markdown"}
highlight_language = "text"
nitpicky = True

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
myst_all_links_external = False
myst_url_schemes = ["http", "https", "mailto"]

html_theme = "furo"
html_title = f"{project} {release}"
html_static_path = ["_static"]
html_extra_path = ["extra"]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_copy_source = False
html_show_sourcelink = False
html_show_search_summary = False  # a local file may not fetch it
html_math_renderer = "mathml"
pygments_style = "friendly"


def _write_mathml(translator: HTML5Translator, node: nodes.Element, block: bool) -> None:
    try:
        shown = tex2mathml(node.astext(), as_block=block)
    except (MathError, SyntaxError) as error:
        raise ExtensionError(f"{node.source}:{node.line}: formula {node.astext()!r}: {error}") from error
    text = shown if isinstance(shown, str) else shown.toprettyxml()
    translator.body.append(re.sub(r"\s*\n\s*", "", text))
    raise nodes.SkipNode


def _write_inline_formula(translator: HTML5Translator, node: nodes.Element) -> None:
    _write_mathml(translator, node, block=False)


def _write_block_formula(translator: HTML5Translator, node: nodes.Element) -> None:
    translator.body.append(translator.starttag(node, "div", CLASS="formula"))
    try:
        _write_mathml(translator, node, block=True)
    finally:
        translator.body.append("</div>\n")


_TEXTS: dict[str, str] = {}  # text of each page


def _keep_text(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: nodes.document) -> None:
    """Collect a page's text; add the texts' script to the page of the search."""
    if doctree is not None:
        _TEXTS[pagename] = " ".join(re.sub(r"<!--.*?-->", "", doctree.astext()).split())
    elif pagename == "search":
        app.add_js_file("texts.js", priority=400)


def _write_texts(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        texts = f"window.siteTexts = {json.dumps(_TEXTS, ensure_ascii=False)};\n"
        (Path(app.outdir) / "_static" / "texts.js").write_text(texts, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register formulas as MathML, and the texts that the search shows."""
    app.connect("html-page-context", _keep_text)
    app.connect("build-finished", _write_texts)
    app.add_html_math_renderer("mathml", (_write_inline_formula, None), (_write_block_formula, None))
    return {"parallel_read_safe": True}
