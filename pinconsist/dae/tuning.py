"""The constants of the method and its failure messages, shared by Python and C++.

The compiled method reads them from here by name when it is loaded (``_core/tuning.hpp`` lists those that it uses).
"""

from dataclasses import dataclass

# Newton's iteration
MAX_ITERATIONS = 10
FRESH_RATE = 0.4  # a slower contraction requires a new and complete matrix
NEWTON_FACTOR = 3e-3  # of the error test; keeps loop gaps down for 3 % more residuals
STAGNANT = 0.7  # a slower contraction than this, close to the solution, is rounding
STAGNATED, LAST = 1e-9, 1e-12  # relative to the velocities: noise in increments if Newton stagnates, or at its end

# Loops and hidden constraint after a step
CLOSINGS = 4  # evaluations of the constraint alone
CLOSED = 1e-15  # relative to the positions: gap that may stay open
GAP = 1e-13  # gap that rounding leaves in closed loops, relative to positions and W

# Step size and order
ACCURACY = 0.1  # of the tolerance: sum of the errors of all steps, before the motion amplifies them
MAX_ORDER, MAX_ADAPTIVE_ORDER = 6, 5
SAFETY = 0.8  # 0.9 rejects twice as often: as many residuals, larger errors
MIN_FACTOR, MAX_FACTOR = 0.2, 10.0  # by which a step changes
AFTER_FAILURE = 0.25  # by which a step changes where Newton failed
NEARLY = 0.92  # of the longest step: if the next lower order (from 3 on) allows this, it is taken: it is more stable
SMALLEST_STEP = 16.0  # spacings of t: a shorter step cannot be distinguished from zero
MAX_CHART_TURN = 2.5  # rad that a chart may span: at π it wraps around

# The first history of a run of variable step, by a one-step method
START_SHARE = 1e-2  # of the tolerances of a step: those of the one-step method
START_STEPS, START_GROWTH = 6, 1.5  # its steps at most, and the growth of each that asks for another
START_TURN = 1.0  # rad that it may turn in one chart
START_SHORTER = 0.7  # factor by which its reach is shortened until it turns no farther
START_ERROR, START_AIM = 0.5, 0.25  # of the tolerance: error allowed in the first step, and aimed at by a shorter one
START_TRIES, START_LEAST = 4, 0.05  # how often, and how much, it is shortened

# Rounding, and no progress
NOISE, STIRRED = 5.0, 0.02  # eps of the positions: rounding in them and, divided by h, in the velocities
HALF = 1e-8  # of the velocities, half their digits: no larger error counts as rounding
BESIDE = 3e-10  # of the velocities: rounding reaches this only near singular positions
SLOW = 0.5  # of the order: errors that fall more slowly with the step are rounding
SUDDEN = 0.5  # of an error: if it is rounding, this part of it was not predicted
SURE = 200.0  # times one rounding error: those of a whole step together, at most
TURNED = 1e-6  # of the positions, by which they are moved to see how the constraint rows turn
UNNOTICED = 0.1  # errors below this do not shorten the next step
PROBING = 500  # steps whose errors are rounding, after which one twice as long is tried
SETBACKS, PROGRESS = 100, 1e-6  # failed tries that end a run, if it has advanced by less than this part since

# Radau IIA
STAGES = (1, 2, 3, 5, 7)  # for orders 1, 3, 5, 9, 13
FEWEST_STAGES, FIRST_STAGES, MOST_STAGES = 3, 5, 7  # where the method chooses them
MOST_STAGES_BELOW = 1e-6  # rtol
CALM, QUICK = 10, 1e-2  # steps after which there may be more stages, and the contraction of Newton that this takes
STAGE_ACCURACY = 1.5  # of the tolerance of a run, from which that of the error estimate follows
STAGE_LEFT = 1e-3  # of the tolerance of a run: what Newton may leave in a step, as it adds up
MAX_STAGE_ITERATIONS = 12
MAX_SWEEPS = 30  # substitutions of the positions where rates depend on them
STAGE_NEWTON_FACTOR = {1: 2e-2, 2: 2e-2, 3: 2e-2, 5: 2e-2, 7: 2e-3}  # of the error test; 7 stages show what is left
STAGE_SAFETY = 0.45  # estimates of high order react late: longer steps are more often rejected than they are worth
STAGE_GROWTH = 2.0  # largest growth of a step; MAX_FACTOR after the first one
FORESEEN = 3.0  # times the last step: a longer one does not start from the polynomial of the last one
STAGE_AFTER_FAILURE = 0.5  # by which a step changes where Newton failed
FELT = 3.0  # eps in stage positions, as they affect the error estimate
FIRST_ERROR = 1e-4  # of the tolerance: error of the first step
RESTARTED = 3.0  # times a first step: the longest step after an event, if steps were that long before
FIRST_REACH, FIRST_CHANGE = 1e-2, 0.1  # of its trial: reach in positions, change of accelerations, relative
FIRST_TRIALS = 20  # each a quarter of the one before
LAST_MODE = 0.01  # of the two highest modes, in the denominator of their decay in the error estimate
LOOKS = 12  # times in a step at which events are evaluated
NUDGE = 1e-6  # of the way to the next evaluation, where an event that was zero takes its sign
HALVING = 20  # tries after which a zero is found by bisection alone

WINDOW = 1000  # steps after which the pace of a run is checked
CHATTER, LONG, ENDLESS = 0.3, 1e5, 1e9  # Newton failures per step; steps to come if a force jumps; if not

PATIENCE = 0.05  # s after which one call makes no more steps, so that an interrupt is noticed

# Only for the compiled method: forecasts of what need not be computed, matrices that are kept
HIDDEN = 7.0  # of Newton's tolerance: hidden residual that may stay; multipliers begin to show it at 20
FORCES = 3.0  # of a step's rtol^(k/(k+1)), relative to the largest G λ: what a hidden residual may change in G λ
FORECAST_ROUNDING = 2e-12  # relative to the velocities: if HIDDEN allows less, the hidden residual is always removed
STALE_FACTOR = 0.3  # of Newton's tolerance for a kept matrix: the multipliers show what linear convergence leaves
WORTH = 32.0  # a new matrix, derivatives and factors, costs as much as nv/WORTH iterations (measured on long chains)
WIDEST = 2.0  # change of c up to which a matrix is kept
WEIGHED = 4  # steps for which the weights of the error norm are kept
REMEMBERED = 20  # steps for which a measurement is used
KEPT = 8  # steps for which the derivatives of forces are kept

FAILURES = {
    "singular": "the KKT matrix is singular",
    "not_finite": "the residual is not finite",
    "diverged": "Newton diverged",
    "not_converged": "Newton did not converge",
    "error_test": "the error test fails at any step size",
    "no_start": "the run could not restart at a jump of the forces",
    "chatters": "the run hardly advances, because Newton fails repeatedly",
}


@dataclass(frozen=True)
class Switches:
    """Features of the compiled method that exist only for speed. With all off, it makes the same steps as Python.

    Attributes
    ----------
    iteration_forecast : bool
        End Newton's iteration after the first increment if, by the last steps, no other matters.
    loop_forecast : bool
        Do not evaluate the constraint again if, by the last steps, loops and hidden constraint stay closed.
    jacobian_reuse : bool
        In large systems, keep the matrix of an earlier step as long as it pays.
    few_constraints : bool
        If constraints are few, solve for the effect of each once, not with every right-hand side.
    kept_weights : bool
        Keep the weights of the error norm for some steps.
    few_derivatives : bool
        In steps of five or more stages, evaluate derivatives at two of them and interpolate the others.
    kept_derivatives : bool
        BDF in small systems: keep the derivatives of the forces for some steps, as long as one iteration is enough.
    """

    iteration_forecast: bool = True
    loop_forecast: bool = True
    jacobian_reuse: bool = True
    few_constraints: bool = True
    kept_weights: bool = True
    few_derivatives: bool = True
    kept_derivatives: bool = True
