// The constants of dae/tuning.py, read from there by name when the module is loaded, and the switches.
#pragma once

#include <cmath>
#include <limits>

namespace pinconsist {

#define PINCONSIST_TUNING(X)                                                                                           \
  X(MAX_ITERATIONS) X(FRESH_RATE) X(NEWTON_FACTOR) X(STAGNANT) X(STAGNATED) X(LAST) X(UNMOVED) X(CLOSINGS) X(CLOSED)   \
  X(GAP) X(SAFETY) X(NEARLY) X(MIN_FACTOR) X(MAX_FACTOR) X(AFTER_FAILURE) X(SMALLEST_STEP) X(MAX_CHART_TURN) X(HALF)   \
  X(DRIFT) X(BESIDE) X(SLOW) X(SUDDEN) X(SURE) X(TURNED) X(UNNOTICED) X(PROBING) X(REMEMBERED) X(SETBACKS) X(PROGRESS)          \
  X(HIDDEN) X(FORECAST_ROUNDING) X(STALE_FACTOR) X(WORTH) X(WIDEST) X(WEIGHED) X(KEPT) X(PATIENCE) X(NOISE)            \
  X(STIRRED) X(FORCES) X(MAX_STAGE_ITERATIONS) X(MAX_SWEEPS) X(STAGE_ACCURACY) X(ACCURACY) X(STAGE_NEWTON) X(STAGE_NEWTON_OF_MOST) X(STAGE_LEFT) X(MOST_STAGES_BELOW) X(RESTARTED) X(ROUGHLY) X(SLOPE_OVER) X(STAGE_SAFETY) X(STAGE_GROWTH)         \
  X(STAGE_AFTER_FAILURE) X(RESOLVED) X(FITTING) X(FORESEEN) X(FELT) X(STIFF) X(STIFF_PART) X(LAST_MODE) X(COARSE) X(UNSEEN)       \
  X(FIRST_ERROR) X(FIRST_REACH) X(FIRST_CHANGE) X(FIRST_TRIALS) X(FEWEST_STAGES) X(FIRST_STAGES) X(MOST_STAGES)        \
  X(CALM) X(QUICK) X(START_SHARE) X(START_STEPS)         \
  X(START_ERROR) X(START_APART) X(HALVING) X(LOOKS) X(LOOKS_OF_BDF) X(SHORTER) X(NUDGE) X(BETWEEN) X(NEXT_MODE) X(NOTABLE)

#define PINCONSIST_DECLARE(name) inline double name = 0.0;
PINCONSIST_TUNING(PINCONSIST_DECLARE)
#undef PINCONSIST_DECLARE

constexpr int MAX_ORDER = 6; // size of arrays; module.cpp compares it with dae/tuning.py

constexpr double EPS = std::numeric_limits<double>::epsilon(), INF = std::numeric_limits<double>::infinity(),
                 NOT_A_NUMBER = std::numeric_limits<double>::quiet_NaN();

// Features that exist only for speed; see dae/tuning.py.
struct Switches {
  bool iteration_forecast = true, loop_forecast = true, jacobian_reuse = true, few_constraints = true,
       kept_weights = true, few_derivatives = true, row_derivatives = true, kept_derivatives = true;
};

} // namespace pinconsist
