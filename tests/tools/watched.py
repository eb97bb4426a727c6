"""A page in a browser, which complains of nothing and asks nothing of another machine."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

OWN = ("file:", "data:", "blob:", "about:", "http://127.0.0.1:", "ws://127.0.0.1:")


@contextmanager
def opened(
    browser: Any,
    url: str,
    width: int = 1200,
    height: int = 900,
    script: str = "",
    own: tuple[str, ...] = OWN,
    **more: Any,
) -> Iterator[Any]:
    """The page; what it asks for beside ``own``, and what it complains of, is an error in the end."""
    held = browser.new_context(viewport={"width": width, "height": height}, **more)
    wrong: list[str] = []
    try:
        page = held.new_page()
        page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda asked: None if asked.url.startswith(own) else wrong.append(asked.url))
        if script:
            page.add_init_script(script)
        page.goto(url)
        yield page
    finally:
        held.close()
    assert wrong == []
