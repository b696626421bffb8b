"""Mutation testing of dae/ and loops.py with mutmut, in a copy: ``python tests/mutants/run.py DIRECTORY``.

Prints killed, survived and timed out by file, and the diff of each survivor. See CONTRIBUTING.md.
"""

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

from mutmut.mutation.file_mutation import mutate_file_contents
from mutmut.stats import status_by_exit_code

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def copy(tree: Path) -> None:
    """The files of the checkout, with the compiled twin, and what mutmut needs beside them."""
    command = ["git", "ls-files", "-co", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()
    for path in [*map(ROOT.joinpath, names), *(ROOT / "pinconsist/_core").glob("twin*.so")]:
        if path.is_file():
            target = tree / path.relative_to(ROOT)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, target)
    for name in ("setup.cfg", "backends.py"):
        shutil.copy(HERE / name, tree / name)


def sample(tree: Path, number: int, seed: int) -> list[str]:
    """Names of mutants, drawn from all files alike."""
    names = []
    for path in [*sorted(tree.glob("pinconsist/dae/*.py")), tree / "pinconsist/mechanism/rows.py"]:
        module = ".".join(path.relative_to(tree).with_suffix("").parts)
        mutants = mutate_file_contents(path.name, path.read_text(encoding="utf-8")).mutant_names
        names += [f"{module}.{name}" for name in mutants]
    print(f"{number} of {len(names)} mutants, seed {seed}")
    return sorted(random.Random(seed).sample(names, number))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", type=Path, help="a new directory for the copy")
    parser.add_argument("--number", type=int, default=240)
    parser.add_argument("--seed", type=int, default=8)
    options = parser.parse_args()
    tree = options.directory.resolve()
    copy(tree)
    os.chdir(tree)  # where mutmut looks for setup.cfg
    names = sample(tree, options.number, options.seed)
    mutmut = ["nice", "-n", "19", sys.executable, "-m", "mutmut"]
    with open(tree / "mutmut.log", "w") as log:
        subprocess.run([*mutmut, "run", "--max-children", "1", *names], stdout=log, check=True)
    found = {}
    for record in tree.glob("mutants/pinconsist/**/*.meta"):
        found |= json.loads(record.read_text(encoding="utf-8"))["exit_code_by_key"]
    outcomes = {name: status_by_exit_code[found[name]] for name in names}
    by_file = {}
    for name, outcome in outcomes.items():
        by_file.setdefault(name.rpartition(".")[0], Counter())[outcome] += 1
    for module, counts in by_file.items():
        print(f"{module:45}", dict(counts))
    print(f"{'all':45}", dict(Counter(outcomes.values())))
    for name in names:
        if outcomes[name] != "killed":
            print(f"\n{outcomes[name]}: {name}", flush=True)
            subprocess.run([*mutmut, "show", name], check=False)


if __name__ == "__main__":
    main()
