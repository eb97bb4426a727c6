"""What left is told where somebody names it, in one line with what to use instead."""

from __future__ import annotations

from places import ROOT

from cosim.base.removed import REMOVED, describe_removed


def test_the_page_on_versions_lists_what_left() -> None:
    page = (ROOT / "docs" / "versions.md").read_text(encoding="utf-8")
    _, _, table = page.partition("| what left |")
    rows = [line.split(" | ") for line in table.partition("\n\n")[0].splitlines()[2:]]
    stated = {
        (what.removeprefix("| "), name, since, instead.removesuffix(" |"))
        for what, names, since, instead in rows
        for name in names.split(", ")
    }
    assert stated == {(left.what, f"`{name}`", left.since, left.instead) for name, left in REMOVED.items()}


def test_a_name_that_never_was_is_not_told_as_one_that_left() -> None:
    assert describe_removed("--controller") is None
