"""python steps.py WHAT ARGUMENT ...: Python with these arguments, pip's or setup.py's, and of its output plain lines.

They are one for each package and what setup.py says of its steps; everything is shown if the command fails.
"""

from __future__ import annotations

import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path


def main(what: str, *arguments: str) -> int:
    """Run the command; return its status."""
    locks = [Path(name) for option, name in pairwise(arguments) if option == "--requirement"]
    texts = [lock.read_text(encoding="utf-8") for lock in locks]
    # A package that has two versions for two Pythons counts once.
    packages = sum(len({*re.findall(r"^(\w[^=]*)==", text, re.MULTILINE)}) for text in texts)
    print(f"set-up: {what}{f': {packages} packages' if packages else ''}", flush=True)
    output, collected = [], 0
    command = [sys.executable, *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as child:
        assert child.stdout is not None
        for line in child.stdout:
            output.append(line)
            if line.startswith(("Collecting ", "Processing ")) and packages:
                collected += 1
                print(f"  {collected}. {Path(line.split()[1]).name}", flush=True)
            elif line.startswith("Installing collected packages") and packages:
                print(f"set-up: {collected} packages are unpacked", flush=True)
            elif line.lstrip().startswith("set-up: "):
                print(line.strip(), flush=True)
    if child.returncode:
        sys.stderr.writelines(output)
    return child.returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
