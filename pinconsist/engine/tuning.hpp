// The constants of the method, and switches of what exists for speed alone.
//
// They are listed by name, so that `python -m benchmarks ablate --constants` can halve and double each.
#pragma once

#include <cmath>
#include <limits>
#include <map>
#include <string>

namespace pinconsist {

inline std::map<std::string, double *> &constants() {
  static std::map<std::string, double *> all;
  return all;
}

#define CONSTANT(name, value)                                                                                          \
  inline double name = value;                                                                                          \
  inline const bool name##_is_listed = constants().emplace(#name, &name).second

// Newton's iteration
CONSTANT(MAX_ITERATIONS, 10);
CONSTANT(FRESH_RATE, 0.4); // a slower contraction requires a new and complete matrix
CONSTANT(NEWTON_FACTOR, 3e-3); // tolerance relative to the error test; keeps loop gaps small for 3 % more residuals
CONSTANT(STAGNANT, 0.7); // a slower contraction than this, close to the solution, is rounding
CONSTANT(STAGNATED, 1e-9); // noise in increments, relative to v, if Newton stagnates
CONSTANT(LAST, 1e-12); // the same at its last iteration
CONSTANT(UNMOVED, 1e3); // roundings of the position that increments of v may cause at rest; 250 in a loop of 100 links

// Loops and hidden constraint after a step
CONSTANT(CLOSINGS, 4); // largest number of evaluations of the constraint alone
CONSTANT(GAP_LEFT, 1e-15); // gap that may remain, relative to the positions
CONSTANT(GAP, 1e-13); // gap that rounding leaves in closed loops, relative to positions and W

// Step size and order
CONSTANT(ACCURACY, 0.1); // sum of the errors of all steps relative to the tolerance, before the motion amplifies them
CONSTANT(SAFETY, 0.8); // 0.9 rejects twice as often: as many residuals, larger errors
CONSTANT(MIN_FACTOR, 0.2); // smallest change of the step size
CONSTANT(MAX_FACTOR, 10.0); // largest
CONSTANT(AFTER_FAILURE, 0.25); // factor of the step size after Newton failed
CONSTANT(LOWER_ORDER, 0.92); // the next lower order, 2 or more, is more stable: it is used if it allows this fraction of the step
CONSTANT(SMALLEST_STEP, 16.0); // in spacings of t: a shorter step cannot be distinguished from zero
CONSTANT(MAX_CHART_TURN, 2.5); // largest angle that a chart may span, rad: at π it wraps around

// The first history of BDF
CONSTANT(START_SHARE, 1e-2); // accuracy of its steps of Radau relative to the tolerance of a step of BDF
CONSTANT(START_STEPS, 3); // their largest number
CONSTANT(START_APART, 64.0); // shortest step of a history, relative to the shortest of all: its times are rounded
CONSTANT(START_ERROR, 0.5); // error allowed in the first step, in tolerances

// Rounding, and no progress
CONSTANT(DRIFT, 1e-11); // rounding of a time, relative to a step, that does not count: a twentieth of the best accuracy of BDF
CONSTANT(POSITION_ROUNDING, 5.0); // in eps of the positions
CONSTANT(VELOCITY_ROUNDING, 0.02); // in eps of the positions divided by the step
CONSTANT(HALF, 1e-8); // larger errors, relative to the velocities, do not count as rounding: half of the digits
CONSTANT(BESIDE, 3e-10); // rounding reaches this, relative to the velocities, only near singular positions
CONSTANT(SLOW, 0.5); // errors that fall with a smaller power of the step, relative to the order, are rounding
CONSTANT(SUDDEN, 0.5); // if an error is rounding, at least this fraction was not predicted
CONSTANT(SURE, 200.0); // bound for all rounding errors of a step, relative to a single one
CONSTANT(TURNED, 1e-6); // relative displacement of the positions that shows how the constraint rows turn
CONSTANT(UNNOTICED, 0.1); // errors below this do not shorten the next step
CONSTANT(PROBING, 500); // number of steps with errors that are rounding after which one twice as long is tried
CONSTANT(SETBACKS, 100); // failed tries after which a run ends, if it has hardly advanced
CONSTANT(PROGRESS, 1e-6); // the fraction by which it must have advanced

// Radau IIA
CONSTANT(FEWEST_STAGES, 3); // if the method chooses the number
CONSTANT(FIRST_STAGES, 5); // with which it begins
CONSTANT(MOST_STAGES, 7);
CONSTANT(MOST_STAGES_BELOW, 1e-6); // largest rtol for which MOST_STAGES may be chosen
CONSTANT(CALM, 10); // steps before the number of stages may grow
CONSTANT(STAGE_ACCURACY, 1.5); // relative to the tolerance of a run; determines the tolerance of the error estimate
CONSTANT(STAGE_LEFT, 1e-3); // error of Newton in a step, which adds up, relative to the tolerance of a run
CONSTANT(MAX_STAGE_ITERATIONS, 12);
CONSTANT(MAX_SWEEPS, 30); // largest number of fixed-point iterations if rates depend on positions
CONSTANT(STAGE_NEWTON, 2e-2); // tolerance of Newton relative to the error test
CONSTANT(STAGE_NEWTON_OF_MOST, 2e-3); // the same with 7 stages, which are more sensitive
CONSTANT(STAGE_SAFETY, 0.45); // estimates of high order react late: a larger factor costs more rejections than it saves
CONSTANT(STAGE_GROWTH, 2.0); // largest growth of a step; MAX_FACTOR after the first one
CONSTANT(RESOLVED, 0.35); // largest ratio of the last coefficient of accelerations to the two before it if they are resolved
CONSTANT(FITTING, 10.0); // largest distance of accelerations at the ends from the polynomial of the stages, in its last modes
CONSTANT(NOTABLE, 0.03); // part of the largest last coefficient that makes an unresolved coordinate count for all
CONSTANT(FELT, 3.0); // rounding in stage positions that affects the error estimate, in eps
CONSTANT(FIRST_ERROR, 1e-4); // error of the first step relative to the tolerance
CONSTANT(RESTARTED, 3.0); // largest step after an event, relative to a first step, if steps were that long before
CONSTANT(FIRST_REACH, 1e-2); // relative change of positions in the trial of a first step
CONSTANT(FIRST_CHANGE, 0.1); // the same of accelerations
CONSTANT(FIRST_TRIALS, 20); // each a quarter of the previous one
CONSTANT(COARSE, 4.0); // widths of friction: nearer to zero velocities are resolved to it; a step that crosses more misses some
CONSTANT(STIFF, 30.0); // a force is stiff if a motion turns or decays by more than this, rad or 1, within a step
CONSTANT(STIFF_PART, 0.3); // a force is stiff if its effect on a velocity exceeds this fraction of it
CONSTANT(UNSEEN, 20.0); // factor of the impulse of sharp forces that the stages miss: two formulas may miss much of it alike
CONSTANT(BETWEEN, 3.0); // error between the ends of a step, in tolerances, from which rows there are interpolated in its halves
CONSTANT(NEXT_MODE, 0.02); // part of BETWEEN that the next mode must reach, for the error to be measured
CONSTANT(REACTIONS, 8); // times that the direction of forces is corrected which depends on the multipliers
CONSTANT(REACTED, 4e-16); // relative change of G that is rounding
CONSTANT(LOOKS, 12); // number of times in a step at which events are evaluated
CONSTANT(LOOKS_OF_BDF, 4); // the same of BDF, whose steps are shorter
CONSTANT(SHORTER, 0.25); // factor by which the time after an event is shortened until its function has left zero
CONSTANT(ROUGHLY, 1e-7); // accuracy of an event before a Newton step, relative to the time between two evaluations
CONSTANT(SLOPE_OVER, 1e-3); // time over which the slope of its function is measured, relative to the same
CONSTANT(RELOCATED, 6); // times that an event just after a start is located again in a shorter step
CONSTANT(AFTER_ZERO, 1e-6); // fraction of the time to the next evaluation after which an event that was zero has its sign
CONSTANT(HALVING, 20); // tries after which a zero is found by bisection alone
CONSTANT(LONGEST_CALL, 0.05); // s after which one call makes no more steps, so that interrupts are noticed

// Events
CONSTANT(SAME_TIME, 1e-13); // relative: events closer than this are simultaneous
CONSTANT(TOUCHING, 1e-9); // rad or m: gap of an impact that counts as closed
CONSTANT(DEEP_GAP, 1e-11); // rad or m: a gap below it at the first event has closed before
CONSTANT(FLIGHT, 1e-5); // change of the state, relative to it, over which the rate of a function is measured that leaves zero
CONSTANT(STOPPED, 1e-9); // rate of a function after an event, relative to that before, that counts as zero
CONSTANT(ROUNDED_FLIGHT, 1e3); // roundings of the position below which flights between occurrences of an event do not count
CONSTANT(FLIGHTS, 3); // number of such flights after which an event accumulates
CONSTANT(FLIGHTS_AT_ONCE, 30); // number of occurrences of an impact at one time after which it does

// Runs that would not end in reasonable time, because a force chatters: Newton fails again and again there
CONSTANT(WINDOW, 1000); // number of steps after which the pace of a run is checked
CONSTANT(CHATTER, 0.3); // failures of Newton per step from which a run may not end
CONSTANT(TOO_MANY, 1e5); // remaining steps that are too many if a force jumps
CONSTANT(ENDLESS, 1e9); // the same if none does

// Redundant constraints
CONSTANT(WEAK, 0.2); // smallest singular value of the kept rows, relative to that of all, below which others are chosen
CONSTANT(JUMP_GAP, 1e-6); // gap of a constraint that jumps, relative to positions and 1 rad or m, from which a run cannot go on
CONSTANT(PUSHED, 1e-9); // change of velocities where rates of constraints jump, relative to them and 1 rad/s or m/s, that is none

// Complementarity problems of contacts
CONSTANT(SWEEPS, 20); // of projected Gauss-Seidel before Newton's method
CONSTANT(ROUNDS, 4); // each with twice as many sweeps as the last, where pivots have failed
CONSTANT(NEWTON_TURNS, 30); // iterations of Newton's method
CONSTANT(ENOUGH_LEFT, 1e-13); // residual, relative to b, at which a problem is solved
CONSTANT(WELL_LEFT, 1e-10); // the same after pivots
CONSTANT(NO_RESPONSE, 1e-14); // diagonal entries, relative to the largest, that are zero
CONSTANT(LONGEST_RHO, 1e3); // step of a projection where there is no diagonal
CONSTANT(DIVERGED, 1e30); // size of unknowns at which sweeps end
CONSTANT(DIRECTIONS, 12); // of friction in a plane, for pivots
CONSTANT(PIVOTS, 50); // for each unknown, after which there is no solution
CONSTANT(PIVOT, 1e-11); // smallest one

// Only for speed: forecasts that avoid evaluations, and matrices that are kept
CONSTANT(STALE_FACTOR, 0.3); // factor of Newton's tolerance for a kept matrix, whose linear convergence affects multipliers
CONSTANT(WORTH, 32.0); // a new matrix and its factors cost as much as nv/WORTH iterations (measured on long chains)
CONSTANT(WIDEST, 2.0); // largest factor of change of c for which a matrix is kept
CONSTANT(REMEMBERED, 20); // number of steps for which a measurement is used
CONSTANT(KEPT, 8); // number of steps for which the derivatives of forces, and Radau's matrix in equal steps, are kept

#undef CONSTANT

constexpr int MAX_ORDER = 6; // of BDF; size of arrays

constexpr double EPS = std::numeric_limits<double>::epsilon(), INF = std::numeric_limits<double>::infinity(),
                 NOT_A_NUMBER = std::numeric_limits<double>::quiet_NaN();

// Features that exist only for speed.
struct Switches {
  bool iteration_forecast = true; // BDF: no second iteration if, judging by the last steps, it would not matter
  bool jacobian_reuse = true;     // BDF in large systems: the matrix of an earlier step, as long as it pays
  bool kept_derivatives = true;   // BDF in small systems: the derivatives of forces of some steps ago
  bool few_derivatives = true;    // Radau with five or more stages: derivatives at two, interpolated at the others
  bool lanes = true;              // Radau: all stages evaluated at once, where the mechanism's joints permit it
  bool row_derivatives = true;    // Radau: the derivative of the constraint forces at once, not only if Newton is slow
  bool kept_matrix = true;        // Radau in steps of equal size, as of a controller: the matrix of some steps ago
};

} // namespace pinconsist
