"""The constants of the method and its failure messages, shared by Python and C++.

C++ reads them from here by name when it is loaded (``_core/tuning.hpp`` lists those that it uses).
"""

from dataclasses import dataclass

# Newton's iteration
MAX_ITERATIONS = 10
FRESH_RATE = 0.4  # a slower contraction requires a new and complete matrix
NEWTON_FACTOR = 3e-3  # tolerance relative to the error test; keeps loop gaps small for 3 % more residuals
STAGNANT = 0.7  # a slower contraction than this, close to the solution, is rounding
STAGNATED, LAST = 1e-9, 1e-12  # noise in increments, relative to v, if Newton stagnates; at its last iteration
UNMOVED = 1e3  # roundings of the position that increments of v may cause at rest; 250 in a loop of 100 links

# Loops and hidden constraint after a step
CLOSINGS = 4  # largest number of evaluations of the constraint alone
CLOSED = 1e-15  # gap that may remain, relative to the positions
GAP = 1e-13  # gap that rounding leaves in closed loops, relative to positions and W

# Step size and order
ACCURACY = 0.1  # sum of the errors of all steps relative to the tolerance, before the motion amplifies them
MAX_ORDER, MAX_ADAPTIVE_ORDER = 6, 5
SAFETY = 0.8  # 0.9 rejects twice as often: as many residuals, larger errors
MIN_FACTOR, MAX_FACTOR = 0.2, 10.0  # limits of the change of the step size
AFTER_FAILURE = 0.25  # factor of the step size after Newton failed
NEARLY = 0.92  # the next lower order, 2 or more, is more stable: it is used if it allows this fraction of the step
SMALLEST_STEP = 16.0  # in spacings of t: a shorter step cannot be distinguished from zero
MAX_CHART_TURN = 2.5  # largest angle that a chart may span, rad: at π it wraps around

# The first history of BDF
START_SHARE = 1e-2  # accuracy of its steps of Radau relative to the tolerance of a step of BDF
START_STEPS = 3  # their largest number
START_APART = 64.0  # shortest step of a history, relative to the shortest of all: its times are rounded
START_ERROR = 0.5  # error allowed in the first step, in tolerances

# Rounding, and no progress
DRIFT = 1e-11  # rounding of a time, relative to a step, that does not count: a twentieth of the best accuracy of BDF
NOISE, STIRRED = 5.0, 0.02  # in eps of the positions: rounding in them and, divided by h, in the velocities
HALF = 1e-8  # larger errors, relative to the velocities, do not count as rounding: half of the digits
BESIDE = 3e-10  # rounding reaches this, relative to the velocities, only near singular positions
SLOW = 0.5  # errors that fall with a smaller power of the step, relative to the order, are rounding
SUDDEN = 0.5  # if an error is rounding, at least this fraction was not predicted
SURE = 200.0  # bound for all rounding errors of a step, relative to a single one
TURNED = 1e-6  # relative displacement of the positions that shows how the constraint rows turn
UNNOTICED = 0.1  # errors below this do not shorten the next step
PROBING = 500  # number of steps with errors that are rounding after which one twice as long is tried
SETBACKS, PROGRESS = 100, 1e-6  # a run ends after so many failed tries, if it has advanced by less than this fraction

# Radau IIA
STAGES = (1, 2, 3, 5, 7)  # for orders 1, 3, 5, 9, 13
FEWEST_STAGES, FIRST_STAGES, MOST_STAGES = 3, 5, 7  # if the method chooses the number
MOST_STAGES_BELOW = 1e-6  # largest rtol for which MOST_STAGES may be chosen
CALM, QUICK = 10, 1e-2  # steps before the number of stages may grow; contraction of Newton required for it
STAGE_ACCURACY = 1.5  # relative to the tolerance of a run; determines the tolerance of the error estimate
STAGE_LEFT = 1e-3  # error of Newton in a step, which adds up, relative to the tolerance of a run
MAX_STAGE_ITERATIONS = 12
MAX_SWEEPS = 30  # largest number of fixed-point iterations if rates depend on positions
STAGE_NEWTON, STAGE_NEWTON_OF_MOST = 2e-2, 2e-3  # of the error test; 7 stages are more sensitive
STAGE_SAFETY = 0.45  # estimates of high order react late: longer steps are more often rejected than they are worth
STAGE_GROWTH = 2.0  # largest growth of a step; MAX_FACTOR after the first one
RESOLVED = 0.35  # largest ratio of the last coefficient of accelerations to the two before it if they are resolved
FITTING = 10.0  # largest distance of accelerations at the ends from the polynomial of the stages, in its last modes
LONGEST = 0.05  # part of the span that a step of BDF covers at most if functions of time act, as at rest
LONGEST_STAGES = 0.1  # the same of Radau, which evaluates them within the step
NOTABLE = 0.03  # part of the largest last coefficient that makes an unresolved coordinate count for all
FORESEEN = 7.0  # a step longer than this, relative to the last, does not start from its polynomial
STAGE_AFTER_FAILURE = 0.5  # factor of the step size after Newton failed
FELT = 3.0  # rounding in stage positions that affects the error estimate, in eps
FIRST_ERROR = 1e-4  # error of the first step relative to the tolerance
RESTARTED = 3.0  # largest step after an event, relative to a first step, if steps were that long before
FIRST_REACH, FIRST_CHANGE = 1e-2, 0.1  # trial of a first step: relative changes of positions, accelerations
FIRST_TRIALS = 20  # each a quarter of the previous one
COARSE = 4.0  # widths of friction: nearer to zero velocities are resolved to it; a step that crosses more misses some
STIFF = 30.0  # turn or decay of a motion within a step from which its force is stiff
STIFF_PART = 0.3  # effect of stiff forces on a velocity, relative to it, from which it counts
UNSEEN = 20.0  # factor of the impulse of sharp forces that the stages miss: two formulas may miss much of it alike
LAST_MODE = 0.01  # share of the two highest modes in the denominator of their decay, in the error estimate
BETWEEN = 3.0  # error between the ends of a step, in tolerances, from which rows there are interpolated in its halves
NEXT_MODE = 0.02  # part of BETWEEN that the next mode must reach, for the error to be measured
LOOKS = 12  # number of times in a step at which events are evaluated
LOOKS_OF_BDF = 4  # the same of BDF, whose steps are shorter
SHORTER = 0.25  # factor by which the time after an event is shortened until its function has left zero
FLIGHT = 1e-5  # change of the state, relative to it, over which the rate of a function is measured that leaves zero
ROUNDED_FLIGHT = 1e3  # roundings of the position below which flights between occurrences of an event do not count
FLIGHTS, AT_ONCE = 3, 30  # number of such flights, and of occurrences at one time, after which an event accumulates
ROUGHLY = 1e-7  # accuracy of an event before a Newton step, relative to the time between two evaluations
SLOPE_OVER = 1e-3  # time over which the slope of its function is measured, relative to the same
NUDGE = 1e-6  # fraction of the time to the next evaluation after which an event that was zero has its sign
HALVING = 20  # tries after which a zero is found by bisection alone

WINDOW = 1000  # number of steps after which the pace of a run is checked
CHATTER, LONG, ENDLESS = 0.3, 1e5, 1e9  # Newton failures per step; remaining steps if a force jumps, and if not

PATIENCE = 0.05  # s after which one call makes no more steps, so that interrupts are noticed

# Only for speed: forecasts that avoid evaluations, and matrices that are kept
HIDDEN = 7.0  # hidden residual that may remain, relative to Newton's tolerance; from 20 on it affects multipliers
FORCES = 3.0  # its effect on G λ, relative to the largest one, in units of the step's rtol^(k/(k+1))
FORECAST_ROUNDING = 2e-12  # if HIDDEN allows less, relative to the velocities, the hidden residual is always removed
STALE_FACTOR = 0.3  # factor of Newton's tolerance for a kept matrix, whose linear convergence affects multipliers
WORTH = 32.0  # a new matrix and its factors cost as much as nv/WORTH iterations (measured on long chains)
WIDEST = 2.0  # largest factor of change of c for which a matrix is kept
WEIGHED = 4  # number of steps for which the weights of the error norm are kept
REMEMBERED = 20  # number of steps for which a measurement is used
KEPT = 8  # number of steps for which the derivatives of forces are kept

FAILURES = {
    "singular": "the KKT matrix is singular",
    "not_finite": "the residual is not finite",
    "diverged": "Newton diverged",
    "not_converged": "Newton did not converge",
    "turns_too_far": "a joint makes half a turn within a step, which is the limit of a rotation chart",
    "error_test": "the error test fails at any step size",
    "chatters": "the run hardly advances, because Newton fails repeatedly",
}


@dataclass(frozen=True)
class Switches:
    """Features that exist only for speed.

    Attributes
    ----------
    iteration_forecast : bool
        End Newton's iteration after the first increment if, judging by the last steps, no other one matters.
    loop_forecast : bool
        Do not evaluate the constraint again if, judging by the last steps, loops and hidden constraint stay closed.
    jacobian_reuse : bool
        In large systems, keep the matrix of an earlier step as long as it pays.
    few_constraints : bool
        If constraints are few, solve for the effect of each once, not with every right-hand side.
    kept_weights : bool
        Keep the weights of the error norm for some steps.
    few_derivatives : bool
        In steps of five or more stages, evaluate derivatives at two of them and interpolate the others.
    row_derivatives : bool
        Radau: include the derivative of the constraint forces where it is known, not only if Newton is slow.
    kept_derivatives : bool
        BDF in small systems: keep the derivatives of the forces for some steps, as long as one iteration is enough.
    """

    iteration_forecast: bool = True
    loop_forecast: bool = True
    jacobian_reuse: bool = True
    few_constraints: bool = True
    kept_weights: bool = True
    few_derivatives: bool = True
    row_derivatives: bool = True
    kept_derivatives: bool = True
