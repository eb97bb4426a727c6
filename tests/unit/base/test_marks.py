"""What a command writes between the marks of a page."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.errors import InputError
from cosim.results.report.marks import check_marks, filled, page_parts, parts_of, row, table, write_marks

PAGE = "# Title\n\n<!-- measured: a -->\nold\n<!-- end -->\ntext <!-- end -->\n<!-- measured: b c -->\n<!-- end -->\n"


def test_parts_are_replaced_and_all_else_stays() -> None:
    assert parts_of(PAGE, "page") == {"a": "old\n", "b c": ""}
    new = filled(PAGE, {"b c": "| 1 |\n| 2 |\n"}, "page")
    assert new == PAGE.replace("b c -->\n", "b c -->\n| 1 |\n| 2 |\n")
    assert filled(new, parts_of(new, "page"), "page") == new


@pytest.mark.parametrize("page", ["<!-- measured: a -->\n", "<!-- end -->\n", PAGE + "<!-- end -->\n"])
def test_marks_that_do_not_come_in_pairs_are_refused(page: str, tmp_path: Path) -> None:
    file = tmp_path / "page.md"
    file.write_text(page)
    with pytest.raises(InputError, match=r"page\.md: its marks do not come in pairs"):
        write_marks(file, {})
    assert file.read_text() == page


def test_a_part_without_a_mark_is_refused_with_the_marks_there_are(tmp_path: Path) -> None:
    file = tmp_path / "page.md"
    file.write_text(PAGE)
    for refuse in (lambda: write_marks(file, {"d": "x\n"}), lambda: check_marks(file, ["a", "d"])):
        with pytest.raises(InputError, match=r"page\.md: no mark <!-- measured: d -->; there are a, b c"):
            refuse()
    assert file.read_text() == PAGE
    check_marks(file, ["a", "b c"])
    with pytest.raises(InputError, match=r"none\.md: No such file"):
        check_marks(tmp_path / "none.md", [])


def test_marks_of_the_data_page_belong_to_the_page(tmp_path: Path) -> None:
    page, data = tmp_path / "page.md", tmp_path / "tables" / "page.md"
    data.parent.mkdir()
    page.write_text(PAGE)
    data.write_text("# Data\n<!-- measured: long -->\n<!-- end -->\n")
    check_marks(page, ["a", "b c", "long"])
    write_marks(page, {"a": "1\n", "long": "2\n"})
    assert page_parts(page) == {"a": "1\n", "b c": "", "long": "2\n"}
    assert page.read_text() == PAGE.replace("old", "1")
    assert data.read_text() == "# Data\n<!-- measured: long -->\n2\n<!-- end -->\n"
    write_marks(data, {"long": "3\n"})
    assert page_parts(page)["long"] == "3\n"
    before = page.read_text(), data.read_text()
    with pytest.raises(InputError, match=r"page\.md: no mark <!-- measured: d -->; there are a, b c, long"):
        write_marks(page, {"a": "4\n", "long": "5\n", "d": ""})
    assert (page.read_text(), data.read_text()) == before


def test_a_mark_on_the_page_and_on_its_data_page_is_refused(tmp_path: Path) -> None:
    page, data = tmp_path / "page.md", tmp_path / "tables" / "page.md"
    data.parent.mkdir()
    page.write_text(PAGE)
    data.write_text("<!-- measured: a -->\n<!-- end -->\n")
    for refuse in (lambda: write_marks(page, {"a": ""}), lambda: check_marks(page, ["a"]), lambda: page_parts(page)):
        with pytest.raises(InputError, match=r"measured: a --> stands on .*page\.md too"):
            refuse()


def test_a_table_is_markdown() -> None:
    assert table(["x", "y"], [["a|b", "1"]]) == "| x | y |\n| --- | ---: |\n| a\\|b | 1 |\n"
    assert row(["*"]) == "| \\* |"
