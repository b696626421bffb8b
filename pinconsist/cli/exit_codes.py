"""What the exit codes of each command mean, for its help."""

from __future__ import annotations

SCENE = "2 wrong input, loops that cannot close, or a singular position"
SAVED = "(what was reached is saved by --out)"
RESUMED = "(what was reached is in the file)"
RUN = f"1 the integration failed {SAVED}; {SCENE}; 130 interrupted {SAVED}"
SHOWN = f"1 the integration of a scene failed (what was reached is shown); {SCENE}; 130 interrupted"
INPUT = "2 wrong input; 130 interrupted"

ALL = f"Exit codes: 0 fine; 1 a run or a case failed, or numbers differ; {SCENE}; 130 interrupted."
OF = {
    command: f"Exit codes: 0 fine; {others}."
    for command, others in {
        "simulate": f"{RUN}: --json then has run.interrupted = true, and run.success too",
        "compare": f"{SCENE}; 130 interrupted",
        "check": f"{SCENE}; 130 interrupted",
        "models": INPUT,
        "replay": SHOWN,
        "plot": SHOWN,
        "rerun": f"1 the numbers differ; {INPUT}",
        "resume": f"1 the integration failed {RESUMED}; 2 wrong input, or a scene that has changed; 130 interrupted "
        f"{RESUMED}: --json then has interrupted = true, and success too",
        "sweep": "1 a case failed (its row says why); 2 wrong input; 130 interrupted (the rows so far are in "
        "FILE.csv.partial)",
    }.items()
}
