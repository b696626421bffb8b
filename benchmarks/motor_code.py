"""What the C code of an Actuation costs: compiled with a loop around each function."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from pinconsist import Actuation, PinconsistError

CALLS, REPEATS = 300, 15
MAIN = """
#include <stdio.h>
#include <time.h>
static double q[] = {%(q)s}, goals[2][MOTORS] = {{%(goals)s}, {%(start)s}};
static double v[MOTORS], A[NV * MOTORS], M[MOTORS * MOTORS], h[MOTORS];
static int call(int which, int i) {
  if (which == 0) return leg_closure(goals[i %% 2], q);
  return which == 1 ? leg_jacobian(q, A) : leg_dynamics(q, v, M, h);
}
int main(void) {
  int which, repeat, i;
  for (which = 0; which < 3; ++which) {
    double least = 1e9;
    for (repeat = 0; repeat < %(repeats)d; ++repeat) {
      const clock_t begun = clock();
      for (i = 0; i < %(calls)d; ++i)
        if (call(which, i)) return 1;
      const double taken = (double)(clock() - begun) / CLOCKS_PER_SEC / %(calls)d;
      if (taken < least) least = taken;
    }
    printf("%%.4g\\n", least);
  }
  return 0;
}
"""


def measured(act: Actuation, step: float, repeats: int = REPEATS) -> list[float]:
    """Times of closure, Jacobian and dynamics, s; NaN where there is no compiler, no CasADi, or no C of it."""
    if (compiler := shutil.which("cc")) is None:
        return [float("nan")] * 3
    start = act.positions()
    numbers = {"q": act.q, "start": start, "goals": start + step}
    texts = {key: ", ".join(map(repr, value.tolist())) for key, value in numbers.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "leg.c"
        try:
            act.to_c(path)
        except PinconsistError:
            return [float("nan")] * 3
        with open(path, "a", encoding="utf-8") as stream:
            stream.write(MAIN % (texts | {"repeats": repeats, "calls": CALLS}))
        subprocess.run([compiler, "-std=c99", "-O2", "-o", folder + "/leg", path, "-lm"], check=True)
        done = subprocess.run([folder + "/leg"], check=True, capture_output=True, text=True)
    return [float(line) for line in done.stdout.split()]
