"""``hexjet paper``: the paper reproduced."""

from __future__ import annotations

from cosim.commands import Command

paper = Command("paper", "hexjet_paper.reproduce:reproduce", "--out runs/paper", runs_code=False)
