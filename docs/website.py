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
FOLDERS = {  # pages about folders that have none
    "scenarios": "reference/scenarios.md",
    "studies": "reference/studies.md",
    "examples": "reference/examples.md",
}
LINK = re.compile(r"\]\(([^)\s]+)\)")
OUTSIDE = re.compile(r"[a-z]+:|#")
FRONT, CONTENTS = "index.md", "contents.md"  # of README.md and docs/README.md
LIVE = ("flight", "comparison", "margins")  # of page_pictures.py: pages that are made for the site and open in place
PICTURE = re.compile(r"!\[([^\]]*)\]\((\S*pictures/page-(\w+)\.png)\)")
DOOR = re.compile(r"^\*\*.+?\*\*.*?^```\n.*?^```$", re.MULTILINE | re.DOTALL)
REFERENCE = "Reference"  # the heading below which the generated pages come


def sources() -> Iterator[Path]:
    """Every page of the repository."""
    yield from sorted(ROOT.glob("*.md"))
    yield from sorted(page for page in DOCS.rglob("*.md") if page.name != "README.md")
    for folder in ("aircraft", "benchmarks", "engines", "fmus"):
        yield from sorted((ROOT / folder).rglob("*.md"))


def contents() -> dict[str, list[str]]:
    """The parts of docs/README.md with the pages that each lists, as seen from the root."""
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
        _write(folder / place(page), _seen_from(page, page.read_text(encoding="utf-8"), folder, live))
    made = pages() | {"examples.md": _examples()} | _python()
    for name, text in made.items():
        _write(folder / "reference" / name, text)
    for kind in ("scenarios", "studies", "examples"):
        shutil.copytree(ROOT / kind, folder / kind, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    text = _seen_from(DOCS / "README.md", (DOCS / "README.md").read_text(encoding="utf-8"), folder, live)
    _write(folder / CONTENTS, LINK.sub(lambda link: f"]({_at_the_root(link[1])})", text))
    index = _in_a_grid((folder / FRONT).read_text(encoding="utf-8"))
    for title, listed in contents().items():
        first = [CONTENTS] if "README.md" in listed else []
        more = [f"reference/{name}" for name in made] if title == REFERENCE else []
        entries = [each for each in first + listed + more if each != "README.md"]
        index += _toctree(title, entries)
    _write(folder / FRONT, index)
    shutil.copy(DOCS / "conf.py", folder)
    shutil.copytree(DOCS / "_static", folder / "_static")
    (folder / "extra").mkdir()
    if live:
        _fly(folder / "extra" / "live")


def place(page: Path) -> str:
    """Where a page of the repository stands in the site's sources."""
    path = page.relative_to(ROOT).as_posix()
    return {"README.md": FRONT, "docs/README.md": CONTENTS}.get(path, path)


def _toctree(title: str, entries: list[str]) -> str:
    names = "\n".join(dict.fromkeys(each.removesuffix(".md") for each in entries))
    return f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{names}\n```\n"


def _in_a_grid(text: str) -> str:
    """The front page with its doors, paragraphs with a name and commands each, beside each other."""
    before, heading, doors = text.partition("## Six doors\n")
    doors, below, after = doors.partition("\n## ")
    found = DOOR.findall(doors)
    inside = "\n".join(f"````{{container}} door\n{_named(door)}\n````" for door in found)
    return f"{before}{heading}\n`````{{container}} doors\n{inside}\n`````\n{below}{after}"


def _named(door: str) -> str:
    """A door whose name is a line of its own, without its full stop."""
    return re.sub(r"^\*\*(.+?)\.?\*\*", r"**\1**", door, count=1)


def _fly(folder: Path) -> None:
    """Make the pages that open in place, each as its command does."""
    from page_pictures import PAGES, write

    folder.mkdir()
    home, done = Path.cwd(), set[str]()
    with tempfile.TemporaryDirectory() as name, redirect_stdout(io.StringIO()):
        try:
            for each in LIVE:
                shutil.copy(write(PAGES[each], Path(name), done), folder / f"{each}.html")
        finally:
            os.chdir(home)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _at_the_root(link: str) -> str:
    """A link of docs/README.md as it is seen from the folder above."""
    if OUTSIDE.match(link) or link.partition("#")[0] in (FRONT, CONTENTS):
        return link
    return link.removeprefix("../") if link.startswith("../") else f"docs/{link}"


def _seen_from(page: Path, text: str, folder: Path, live: bool) -> str:
    """The page's text; files that it leads to are copied, folders are led to by their pages."""
    where = "README.md" if page == DOCS / "README.md" else page.relative_to(ROOT).as_posix()
    up = "../" * where.count("/")

    def led(match: re.Match[str]) -> str:
        link = match[1]
        if OUTSIDE.match(link):
            return match[0]
        path, mark, anchor = link.partition("#")
        target = (page.parent / path).resolve()
        found = target.relative_to(ROOT)
        if target in (ROOT / "README.md", DOCS / "README.md"):
            return f"]({up}{place(target)}{mark}{anchor})"
        if target.is_dir():
            about = FOLDERS.get(found.as_posix(), f"{found.as_posix()}/README.md")
            if (ROOT / about).is_file() or about.startswith("reference/"):
                return f"]({up}{about})"
            return "]\0"
        if target.is_file() and target.suffix != ".md":
            (folder / found).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(target, folder / found)
        return match[0]

    def shown(match: re.Match[str]) -> str:
        alt, path, name = match.groups()
        if not live or name not in LIVE:
            return match[0]
        return f"\n```{{image}} {path}\n:alt: {alt}\n:class: live\n:target: {up}live/{name}.html\n```\n"

    text = re.sub(r"\[([^\]]*)\]\0", r"\1", LINK.sub(led, text))  # a folder without a page: what it is called
    return PICTURE.sub(shown, text)


def _examples() -> str:
    """The programs of examples/, whole."""
    shown = "# Examples\n\nPrograms of half a page, each a notebook cell by cell; a test runs them as they stand.\n"
    for path in sorted((ROOT / "examples").glob("*.py")):
        shown += f"\n## {path.name}\n\n```{{literalinclude}} ../examples/{path.name}\n:language: python\n```\n"
    return shown


def _python() -> dict[str, str]:
    """The pages of the Python API, by a process that runs from source: what is compiled has no docstrings."""
    printed = subprocess.run([sys.executable, "-P", str(DOCS / "api.py")], capture_output=True, text=True, check=True)
    made: dict[str, str] = json.loads(printed.stdout)
    return made


def build(folder: Path, source: Path | None = None) -> int:
    """Make the site in a folder; gives back Sphinx's status, 0 without a warning."""
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
