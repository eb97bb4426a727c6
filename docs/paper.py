"""Reproduces the paper, and writes the tables of docs/paper.md between its marks.

python docs/paper.py [--out runs/paper]        what is in that folder already is taken up
"""

from __future__ import annotations

import argparse
from pathlib import Path

from cosim.pages import check_marks, write_marks
from hexjet_paper.report.pages import NAMED, page_parts
from hexjet_paper.reproduce import reproduce

PAGE = Path(__file__).parent / "paper.md"

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/paper"))
    check_marks(PAGE, NAMED)
    write_marks(PAGE, page_parts(reproduce(parser.parse_args().out)))
