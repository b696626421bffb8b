"""Run the commands that a page shows, one after the other, and put what they print below them.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python docs/renew.py docs/benchmarks.md "## andrews" "## Chains"

renews the blocks below these headings; with no heading, all. A block is an indented line that begins with `pinconsist`,
an empty line, and a ```text fence. What the prose says of the figures is for you to read again.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

BLOCK = re.compile(r"^    (pinconsist [^\n]+)\n\n```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TERMINAL = {"COLUMNS": "164"}  # that tables are set for


def renewed(match) -> str:
    """The block with what its command prints now."""
    command = match[1]
    print(command, flush=True)
    run = subprocess.run(shlex.split(command), capture_output=True, text=True, env=os.environ | TERMINAL)
    if run.returncode:
        sys.exit(f"exit code {run.returncode}\n{run.stdout}{run.stderr}")
    lines = [line.rstrip() for line in run.stdout.strip("\n").splitlines()]
    return "    " + command + "\n\n```text\n" + "\n".join(lines) + "\n```"


def main(page: str, *headings: str) -> None:
    path = Path(page)
    parts = re.split(r"^(?=## )", path.read_text(), flags=re.MULTILINE)
    if missing := set(headings) - {part.splitlines()[0] for part in parts}:
        sys.exit(f"{page} has no {', '.join(sorted(missing))}")
    for i, part in enumerate(parts):
        if not headings or part.splitlines()[0] in headings:
            parts[i] = BLOCK.sub(renewed, part)
            path.write_text("".join(parts))


if __name__ == "__main__":
    main(*sys.argv[1:])
