"""Makes the documentation's site: ``python docs/website.py [FOLDER]``, or ``make docs``.

The pages are those of the repository, which are read as they are too, and pages of reference that ``reference.py``
makes of the code.  They are put together as they stand in the repository, so that their links lead where they lead
there; a link to a file that is no page is a download, one to a folder leads to the page about it.  Warnings are errors:
a link or an anchor that leads nowhere ends the build, with its page and line.
"""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
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


def stage(folder: Path) -> None:
    """Write the sources of the site into an empty folder."""
    from reference import pages

    shutil.rmtree(folder, ignore_errors=True)
    for page in sources():
        _write(folder / page.relative_to(ROOT), _seen_from(page, page.read_text(encoding="utf-8"), folder))
    made = pages() | {"examples.md": _examples()}
    for name, text in made.items():
        _write(folder / "reference" / name, text)
    for kind in ("scenarios", "studies", "examples"):
        shutil.copytree(ROOT / kind, folder / kind, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    text = _seen_from(DOCS / "README.md", (DOCS / "README.md").read_text(encoding="utf-8"), folder)
    index = LINK.sub(lambda link: f"]({_at_the_root(link[1])})", text)
    for title, listed in contents().items():
        more = [f"reference/{name}" for name in made] if title == REFERENCE else []
        entries = "\n".join(dict.fromkeys(each.removesuffix(".md") for each in listed + more))
        index += f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{entries}\n```\n"
    _write(folder / "index.md", index)
    shutil.copy(DOCS / "conf.py", folder)
    shutil.copytree(DOCS / "_static", folder / "_static")


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _at_the_root(link: str) -> str:
    """A link of docs/README.md as it is seen from the folder above."""
    if OUTSIDE.match(link):
        return link
    return link.removeprefix("../") if link.startswith("../") else f"docs/{link}"


def _seen_from(page: Path, text: str, folder: Path) -> str:
    """The page's text; files that it leads to are copied, folders are led to by their pages."""

    def led(match: re.Match[str]) -> str:
        link = match[1]
        if OUTSIDE.match(link):
            return match[0]
        target = (page.parent / link.partition("#")[0]).resolve()
        place = target.relative_to(ROOT)
        up = "../" * (len(page.relative_to(ROOT).parts) - 1)
        if target == DOCS / "README.md":
            return f"]({up}index.md)"
        if target.is_dir():
            about = FOLDERS.get(place.as_posix(), f"{place.as_posix()}/README.md")
            if (ROOT / about).is_file() or about.startswith("reference/"):
                return f"]({up}{about})"
            return "]\0"
        if target.is_file() and target.suffix != ".md":
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(target, folder / place)
        return match[0]

    return re.sub(r"\[([^\]]*)\]\0", r"\1", LINK.sub(led, text))  # a folder without a page: what it is called


def _examples() -> str:
    """The programs of examples/, whole."""
    shown = "# Examples\n\nPrograms of half a page, each a notebook cell by cell; a test runs them as they stand.\n"
    for path in sorted((ROOT / "examples").glob("*.py")):
        shown += f"\n## {path.name}\n\n```{{literalinclude}} ../examples/{path.name}\n:language: python\n```\n"
    return shown


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
