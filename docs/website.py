"""Makes the documentation's site: ``python docs/website.py [FOLDER]``, or ``make docs``.

The pages are those of the repository, which are read as they are too, and pages of reference that ``reference.py``
makes of the code.  They are put together as they stand in the repository, so that their links lead where they lead
there; a link to a file that is no page is a download, one to a folder leads to the page about it.  README.md is the
front page, its section of doors a grid.  Pictures of pages that are listed in ``LIVE`` open the page itself, which is
flown for the site.  Warnings are errors: a link or an anchor that leads nowhere ends the build, with its page and line.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
BUILD = ROOT / "build" / "site"
FOLDERS = {  # pages that describe folders
    "scenarios": "reference/scenarios.md",
    "studies": "reference/studies.md",
    "examples": "reference/examples.md",
}
LINK = re.compile(r"\]\(([^)\s]+)\)")
OUTSIDE = re.compile(r"[a-z]+:|#")
FRONT, CONTENTS = "index.md", "contents.md"  # of README.md, docs/README.md
LIVE = ("flight", "comparison", "margins")  # pages that open in place
PICTURE = re.compile(r"!\[([^\]]*)\]\((\S*pictures/page-(\w+)\.png)\)")
DOOR = re.compile(r"^\*\*.+?\*\*.*?^```\n.*?^```$", re.MULTILINE | re.DOTALL)
REFERENCE = "Reference"  # heading of the generated pages


def sources() -> Iterator[Path]:
    """Yield every page of the repository."""
    yield from sorted(ROOT.glob("*.md"))
    yield from sorted(page for page in DOCS.rglob("*.md") if page.name != "README.md")
    for folder in ("aircraft", "benchmarks", "engines", "fmus"):
        yield from sorted((ROOT / folder).rglob("*.md"))


def contents() -> dict[str, list[str]]:
    """Return the parts of docs/README.md with the pages that each lists, as paths from the root."""
    parts: dict[str, list[str]] = {}
    for part in re.split(r"^## ", (DOCS / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        title, _, text = part.partition("\n")
        listed = [(DOCS / link.partition("#")[0]).resolve() for link in LINK.findall(text) if not OUTSIDE.match(link)]
        parts[title] = [path.relative_to(ROOT).as_posix() for path in listed if path.suffix == ".md"]
    return parts


def stage(folder: Path, live: bool = True) -> None:
    """Write the sources of the site into an empty folder; ``live``: with the pages that open in place."""
    from reference import pages

    shutil.rmtree(folder, ignore_errors=True)
    for page in sources():
        _write_file(folder / find_target(page), _resolve_links(page, page.read_text(encoding="utf-8"), folder, live))
    made = pages() | {"examples.md": _make_examples_page()} | _make_python_pages()
    for name, text in made.items():
        _write_file(folder / "reference" / name, text)
    for kind in ("scenarios", "studies", "examples"):
        shutil.copytree(ROOT / kind, folder / kind, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    text = _resolve_links(DOCS / "README.md", (DOCS / "README.md").read_text(encoding="utf-8"), folder, live)
    _write_file(folder / CONTENTS, LINK.sub(lambda link: f"]({_resolve_from_root(link[1])})", text))
    index = _arrange_front_page((folder / FRONT).read_text(encoding="utf-8"))
    for title, listed in contents().items():
        first = [CONTENTS] if "README.md" in listed else []
        more = [f"reference/{name}" for name in made] if title == REFERENCE else []
        entries = [each for each in first + listed + more if each != "README.md"]
        index += _format_toctree(title, entries)
    _write_file(folder / FRONT, index)
    shutil.copy(DOCS / "conf.py", folder)
    shutil.copytree(DOCS / "_static", folder / "_static")
    (folder / "extra").mkdir()
    if live:
        _make_live_pages(folder / "extra" / "live")


def find_target(page: Path) -> str:
    """Return a page's place in the site's sources."""
    path = page.relative_to(ROOT).as_posix()
    return {"README.md": FRONT, "docs/README.md": CONTENTS}.get(path, path)


def _format_toctree(title: str, entries: list[str]) -> str:
    names = "\n".join(dict.fromkeys(each.removesuffix(".md") for each in entries))
    return f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{names}\n```\n"


def _arrange_front_page(text: str) -> str:
    """Return the front page with its entries, each a name, text and commands, in a grid."""
    before, heading, doors = text.partition("## Six doors\n")
    doors, below, after = doors.partition("\n## ")
    found = DOOR.findall(doors)
    inside = "\n".join(f"````{{container}} door\n{_format_door(door)}\n````" for door in found)
    return f"{before}{heading}\n`````{{container}} doors\n{inside}\n`````\n{below}{after}"


def _format_door(door: str) -> str:
    """Return an entry of the front page with its name on a line of its own."""
    return re.sub(r"^\*\*(.+?)\.?\*\*", r"**\1**", door, count=1)


def _make_live_pages(folder: Path) -> None:
    """Make the pages that open in place, each by its command."""
    from page_pictures import PAGES, write

    folder.mkdir()
    home, done = Path.cwd(), set[str]()
    with tempfile.TemporaryDirectory() as name, redirect_stdout(io.StringIO()):
        try:
            for each in LIVE:
                shutil.copy(write(PAGES[each], Path(name), done), folder / f"{each}.html")
        finally:
            os.chdir(home)


def _write_file(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _resolve_from_root(link: str) -> str:
    """Return a link of docs/README.md as it is from the folder above."""
    if OUTSIDE.match(link) or link.partition("#")[0] in (FRONT, CONTENTS):
        return link
    return link.removeprefix("../") if link.startswith("../") else f"docs/{link}"


def _resolve_links(page: Path, text: str, folder: Path, live: bool) -> str:
    """Return a page's text with links for the site; files that it links to are copied."""
    where = "README.md" if page == DOCS / "README.md" else page.relative_to(ROOT).as_posix()
    up = "../" * where.count("/")

    def replace_link(match: re.Match[str]) -> str:
        link = match[1]
        if OUTSIDE.match(link):
            return match[0]
        path, mark, anchor = link.partition("#")
        target = (page.parent / path).resolve()
        found = target.relative_to(ROOT)
        if target in (ROOT / "README.md", DOCS / "README.md"):
            return f"]({up}{find_target(target)}{mark}{anchor})"
        if target.is_dir():
            about = FOLDERS.get(found.as_posix(), f"{found.as_posix()}/README.md")
            if (ROOT / about).is_file() or about.startswith("reference/"):
                return f"]({up}{about})"
            return "]\0"
        if target.is_file() and target.suffix != ".md":
            (folder / found).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(target, folder / found)
        return match[0]

    def replace_picture(match: re.Match[str]) -> str:
        alt, path, name = match.groups()
        if not live or name not in LIVE:
            return match[0]
        return f"\n```{{image}} {path}\n:alt: {alt}\n:class: live\n:target: {up}live/{name}.html\n```\n"

    text = re.sub(r"\[([^\]]*)\]\0", r"\1", LINK.sub(replace_link, text))  # a folder without a page
    return PICTURE.sub(replace_picture, text)


def _make_examples_page() -> str:
    """Return the page of the programs of examples/."""
    text = "# Examples\n\nPrograms of half a page, each a notebook cell by cell; a test runs them as they stand.\n"
    for path in sorted((ROOT / "examples").glob("*.py")):
        text += f"\n## {path.name}\n\n```{{literalinclude}} ../examples/{path.name}\n:language: python\n```\n"
    return text


def _make_python_pages() -> dict[str, str]:
    """Make the pages of the Python API in a process that runs from source, as compiled code has no docstrings."""
    printed = subprocess.run([sys.executable, "-P", str(DOCS / "api.py")], capture_output=True, text=True, check=True)
    made: dict[str, str] = json.loads(printed.stdout)
    return made


def build(folder: Path, source: Path | None = None) -> int:
    """Make the site in a folder; return Sphinx's status, 0 without a warning."""
    from sphinx.cmd.build import main

    source = source or folder.parent / f"{folder.name}-sources"
    stage(source)
    return main(
        ["-q", "-W", "--keep-going", "-E", "-b", "html", "-d", str(source / ".doctrees"), str(source), str(folder)]
    )


if __name__ == "__main__":
    chosen = Path(sys.argv[1]).absolute() if len(sys.argv) > 1 else BUILD
    status = build(chosen)
    if not status:
        print(f"{chosen / 'index.html'}")
    sys.exit(status)
