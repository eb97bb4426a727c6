"""What `hexjet paper --page` asks of a page before it flies."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from cosim.base.errors import InputError
from cosim.cli.main import cli
from hexjet_paper.report.pages import NAMED, check_page


def test_a_page_without_a_mark_of_ours_is_refused_before_the_flights(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Text\n<!-- measured: step -->\n<!-- end -->\n", encoding="utf-8")
    with pytest.raises(InputError, match="no mark that this command fills; there are <!-- measured: paper: counts -->"):
        check_page(page)
    done = CliRunner().invoke(cli, ["paper", "--page", str(page), "--out", str(tmp_path / "out")])
    assert isinstance(done.exception, InputError)  # what the command makes status 2 of
    assert not (tmp_path / "out").exists()
    page.write_text(f"# Text\n<!-- measured: {NAMED[-1]} -->\n<!-- end -->\n", encoding="utf-8")
    check_page(page)
