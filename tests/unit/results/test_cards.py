"""Pages that are a list of cards."""

from __future__ import annotations

from pathlib import Path

from cosim.pages import Card, Page, code, coloured, link, marked


def written(page: Page, folder: Path) -> str:
    page.write(folder / "page.html")
    return (folder / "page.html").read_text(encoding="utf-8")


def test_a_page_shows_its_head_and_its_cards_in_order(tmp_path: Path) -> None:
    cards = [
        Card("Numbers", ("key", "value"), [("lag <1>", "0.2 s")], "small print", lines=["alone"], code="hexjet"),
        None,
        Card("Curves", figure=("a", "b"), is_folded=True, is_half=True),
    ]
    page = Page(
        "test", "A & B", cards, {"a": {"data": [], "layout": {}}, "b": {"data": [], "layout": {}}},
        verdict="shown", badge="met", answer=["the answer"], problems=["a problem"], summary=["done so"],
        evidence=["because"], notes=["beware"], facts=[("seed", "1")], source="from here",
    )  # fmt: skip
    text = written(page, tmp_path).partition("<body>")[2]
    shown = [
        "A &amp; B", '<span class="badge met">shown', '<p class="verdict">the answer', '<p class="unmet">a problem',
        '<p class="dim">done so', "<li>because", '<p class="note">beware', "<dt>seed</dt><dd>1", "<h2>Numbers",
        "<p>alone", '<th class="nowrap">value', "lag &lt;1&gt;", "small print", '<code class="command">hexjet',
        '<section class="card half">', '"heading">Curves', 'data-figure="a"', 'data-figure="b"', "<footer>from here",
    ]  # fmt: skip
    places = [text.find(each) for each in shown]
    assert -1 not in places
    assert places == sorted(places)
    assert 'id="figure-a"' in text
    assert "data-alone" not in text


def test_what_a_page_lacks_leaves_nothing(tmp_path: Path) -> None:
    text = written(Page("test", "bare", [Card("empty", ("a", "b"))]), tmp_path).partition("<body>")[2]
    for each in ("badge", "<ul>", "<dl", "<table", "<code", 'class="plot', "figure-", "replay"):
        assert each not in text


def test_numbers_are_to_the_right_and_texts_to_the_left() -> None:
    long = "a sentence that is broken into lines, as it is wide"
    rows = [("a", "1.2 ms", "roll", "smith, and another", long, "–"), ("b", "–", "4 of 5", "2", long, "< 0.1")]
    assert Card("", (), rows).alignments == ["left nowrap", "nowrap", "left nowrap", "left", "left long", "nowrap"]
    assert Card("", (), [(marked("-3 dB", "met"),)]).alignments == ["nowrap"]


def test_html_within_a_text_is_escaped() -> None:
    assert code("a<b") == "<code>a&lt;b</code>"
    assert link("run", 'a"b') == '<a href="a&#34;b">run</a>'
    assert link("<run>", "") == "&lt;run&gt;"
    assert coloured("<", "#123456") == '<span class="swatch" style="background:#123456"></span>&lt;'
