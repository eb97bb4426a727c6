"""An error in one line: where it was raised, in whose file."""

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from cosim.base.errors import describe_error


def test_the_place_is_in_the_users_file_whatever_its_name(tmp_path: Path) -> None:
    file = tmp_path / "my_importlib.py"
    code = compile("x = 1\n1 / 0\n", str(file), "exec")
    with pytest.raises(ZeroDivisionError) as raised:
        exec(code, {})
    assert describe_error(raised.value) == "ZeroDivisionError: division by zero (my_importlib.py:2)"


@pytest.mark.parametrize("value", ["cosim.no_such_module:NAME", "cosim.base.errors:NO_SUCH_NAME"])
def test_the_files_that_import_are_no_place(value: str) -> None:
    with pytest.raises((ImportError, AttributeError)) as raised:
        EntryPoint("name", value, "group").load()
    assert not describe_error(raised.value).endswith(")")
