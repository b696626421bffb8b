"""Why a run ended early: where, which row, the likely reason, what to try."""

import numpy as np

from ..errors import PinconsistError
from .norms import largest

FAILURES = {
    "singular": "the KKT matrix is singular",
    "not_finite": "the residual is not finite",
    "diverged": "Newton diverged",
    "not_converged": "Newton did not converge",
    "turns_too_far": "a joint makes half a turn within a step, which is the limit of a rotation chart",
    "error_test": "the error test fails at any step size",
    "chatters": "the run hardly advances, because Newton fails repeatedly",
}
"""What ended a run, by the names that the engine has for it."""

NEARLY_DEPENDENT = 1e-2
LATE = 1e5  # s: near larger times, steps that a run may need are rounded
SHARED = 0.9  # a row with this fraction of the largest part in a dependency is named, too


def failure_report(stepper, failure: str) -> str:
    """The message about a run that could not continue."""
    system, method = stepper.system, stepper.method
    where = f"{failure} at t = {stepper.t:.9g} with step {stepper.h:.3g} (order {stepper.k})"
    hints = []
    if method.consistency != "every-step" and method.step is None:
        hints.append(
            f"consistency={method.consistency!r} with variable steps lets the hidden residual jump at every change of "
            "step, and the error test fails there; use consistency='every-step'"
        )
    condition, rows = _weakest_rows(stepper)
    if condition < NEARLY_DEPENDENT:
        hints.append(
            f"the constraints are nearly dependent there ({rows}; smallest singular value {condition:.1e} of the "
            "largest): a singular configuration, where the motion branches, or the end of the range of a drive. "
            "Whether a run passes through a singular configuration depends on where its steps fall: try another "
            + _other(method)
        )
    if "not finite" in failure:
        hints.append("a force or a user-defined function returned NaN or infinity")
    names = jumping(stepper)
    if names or failure == FAILURES["chatters"]:
        hints.append(
            f"{names or 'most likely a force'} jumps when the velocity changes slightly, as a relay or dry friction "
            "with sign(s) does; smooth it, with tanh(s/width) in place of sign(s) or JointFriction, over a larger width"
        )
    if not hints:
        speed = largest(stepper.v)
        smaller = "a smaller step" if method.step is not None else "looser tolerances, or max_step"
        hints.append(f"the largest velocity there is {speed:.3g}; try {smaller}, and look at the motion just before")
        if abs(stepper.t) > LATE:
            hints.append("times this large are rounded too coarsely for such steps: start the run near t = 0")
        elif system.moving and method.name == "Radau":
            hints.append(
                "if the acceleration of a drive jumps there, pass its rate and acceleration as well, or use BDF"
            )
    return f"{where}. " + "; ".join(hints)


def jumping(stepper) -> str:
    """The names of forces that jump at the current state of the run."""
    system = stepper.system
    try:
        with np.errstate(all="ignore"):
            return " and ".join(map(repr, system.jumps(stepper.t, stepper.p, stepper.v)))
    except PinconsistError:  # a user's function that fails there has its own message
        return ""


def _other(method) -> str:
    """An option that changes the steps; relative tolerances below the smallest that can be met all act alike."""
    if method.step is not None:
        return "step, such as one that is 10 % longer"
    rtol = max(method.control.best, *(part.min() for part in method.control.rtol))
    return f"rtol, such as {2.0 * rtol:.2g}"


def _weakest_rows(stepper):
    """(σ_min/σ_max of W with rows of unit length, the row that contributes most to it, or two that share this)."""
    system, v = stepper.system, stepper.v
    if not system.nc:
        return 1.0, ""
    system.evaluate(stepper.t, stepper.p, v, np.zeros(system.nv))
    unused = np.empty((system.nv, system.nv))
    W = np.array(system.linearize(stepper.t, stepper.p, v, np.zeros(system.nv), np.zeros(system.nc), 0.0, unused))
    lengths = np.linalg.norm(W, axis=1, keepdims=True)
    if lengths.min() > 1e-4 * lengths.max():  # a vanishing row is the cause of the failure, not an effect of units
        W = W / np.maximum(lengths, 1e-300)
    if not np.isfinite(W).all():
        return 1.0, ""
    U, s, _ = np.linalg.svd(W)
    parts = np.abs(U[:, len(s) - 1])
    first, *others = np.argsort(-parts)
    rows = [first, *(row for row in others[:1] if parts[row] > SHARED * parts[first])]
    return float(s[-1] / s[0]), " and ".join(system.describe_row(int(row)) for row in rows)


def culprits(system, t, p, v) -> str:
    """The forces that are not finite at a state, for a message, if the system knows them."""
    names, step = system.not_finite(t, p, v), 1e-9 * (1.0 + largest(p)) / (1.0 + largest(v))
    for side in (step, -step):  # at the edge of a domain, neighbouring states are tried
        names = names or system.not_finite(t, system.integrate(p, side * system.rate(t, p, v)), v)
    return f" ({', '.join(map(repr, names))} at t = {t:.9g})" if names else ""
