"""``python -m benchmarks``: the same as ``hexjet benchmark``."""

from __future__ import annotations

import sys

from cosim.cli.main import main

if __name__ == "__main__":
    main(["benchmark", *sys.argv[1:]])
