// Forecasts from the last steps: work that cannot matter is left out, old matrices are kept.
#pragma once

#include "tuning.hpp"

#include <algorithm>

namespace pinconsist {

// Remembers how Newton's iteration contracted, and what closing the loops a second time changed. With c = h/α and s the
// weighted size of the first increment, the next increment is assumed to be a multiple of c² s, the gap that is left in
// the loops a multiple of (c s)², and the hidden residual a multiple of c s.
class Forecast {
public:
  explicit Forecast(const Switches &switches)
      : of_iterations_(switches.iteration_forecast), of_loops_(switches.loop_forecast) {}

  void forget() { trusted_ = looks_ = 0; }

  // Whether no increment after the first one matters.
  bool one_is_enough(double size, double c, double tol) {
    --trusted_;
    return of_iterations_ && trusted_ >= 0 && contraction_ * c * c * size <= tol;
  }
  // Two iterations were made, and the second increment was `rate` times the first.
  void measured(double rate, double c) {
    contraction_ = std::max(rate / (c * c), 0.3 * contraction_);
    trusted_ = static_cast<int>(REMEMBERED);
  }
  // Whether the loops and the hidden constraint need no second evaluation; `force` is the error allowed in the
  // constraint forces, which the hidden residual changes in proportion to 1/c.
  bool stays_closed(double size, double c, double tol, double force) {
    --looks_;
    const double moved = std::abs(c) * size, allowed = HIDDEN * tol;
    const bool foreseen = looks_ >= 0 && allowed >= least_;
    return of_loops_ && foreseen && gap_ * moved * moved <= CLOSED && hidden_ * moved <= allowed &&
           force_ * size <= force;
  }
  // The fraction of the last gap that remains after a correction with the Jacobian of the prediction: a gap is half of
  // the change of the Jacobian along the displacement, times the displacement `moved`.
  double closing_rate(double size, double c, double moved) const {
    return moved != 0.0 ? std::min(1.0, 2.0 * gap_ * c * c * size * size / moved) : 0.0;
  }
  // `shift` and `speed`: root mean squares of the weighted shift of the velocities, and of themselves; `force`: the
  // largest change of the constraint forces.
  void looked(double gap, double shift, double speed, double force, double size, double c) {
    const double moved = std::abs(c) * size == 0.0 ? 1.0 : std::abs(c) * size;
    gap_ = gap / (moved * moved);
    hidden_ = shift / moved;
    force_ = force / (size == 0.0 ? 1.0 : size);
    looks_ = static_cast<int>(REMEMBERED);
    least_ = FORECAST_ROUNDING * speed;
  }

private:
  bool of_iterations_, of_loops_;
  double contraction_ = 1.0, gap_ = 0.0, hidden_ = 0.0, force_ = 0.0, least_ = 0.0;
  int trusted_ = 0, looks_ = 0;
};

// In systems with a new matrix for every step, keeps the derivatives of the forces for some steps, as long as one
// iteration is enough; mass matrix and constraint directions, which affect the multipliers, are those of the step.
class KeptDerivatives {
public:
  explicit KeptDerivatives(bool possible) : possible_(possible) {}

  bool possible() const { return possible_; }
  void forget() { left_ = 0; }
  // Whether the matrix of this step needs new derivatives.
  bool fresh(bool wanted) {
    if (wanted) left_ = 0;
    const bool fresh = --left_ < 0;
    if (fresh) left_ = static_cast<int>(KEPT);
    return fresh;
  }
  // One iteration was not enough with derivatives of an earlier step.
  void not_enough() {
    if (left_ < static_cast<int>(KEPT)) left_ = 0;
  }

private:
  bool possible_;
  int left_ = 0;
};

// Keeps a Newton matrix as long as a step with it costs less than the average step since it was made. This minimises
// the cost per step: the average falls as long as another step adds less. Costs are counted in iterations, not in
// seconds, so that runs can be repeated.
class JacobianReuse {
public:
  JacobianReuse(int nv, bool on) : possible_(on && nv >= WORTH), price_(nv / WORTH) {}

  void forget() { known_ = false; }
  bool possible() const { return possible_; }

  bool pays(double c) {
    const int last = iterations_;
    iterations_ = 0;
    kept_ = false;
    cost_ += last;
    ++steps_;
    --paused_;
    if (steps_ == 1) first_ = cost_;
    if (!possible_ || paused_ > 0 || !known_) return false;
    const double ratio = c / c_;
    if (!(1.0 / WIDEST <= ratio && ratio <= WIDEST)) return false;
    kept_ = last * steps_ <= cost_;
    return kept_;
  }
  void made(double c) {
    if (kept_) { // the old matrix failed, and its iterations are lost
      cost_ += iterations_;
      iterations_ = 0;
      kept_ = false;
    }
    if (cost_ > first_ * steps_) paused_ = static_cast<int>(REMEMBERED);
    c_ = c;
    known_ = true;
    cost_ = price_;
    steps_ = 0;
  }
  void iterated() { ++iterations_; }

private:
  bool possible_, known_ = false, kept_ = false;
  double price_, c_ = 0.0, cost_ = 0.0, first_ = 0.0;
  int paused_ = 0, steps_ = 0, iterations_ = 0;
};

} // namespace pinconsist
