// Forecasts from the last steps: work that cannot matter is left out, old matrices are kept.
#pragma once

#include "tuning.hpp"

#include <algorithm>

namespace pinconsist {

// Remembers how Newton's iteration contracted. With c = h/α and s the weighted size of the first increment, the next
// increment is assumed to be a multiple of c² s.
class Forecast {
public:
  explicit Forecast(bool on) : on_(on) {}

  void forget() { trusted_ = 0; }

  // Whether no increment after the first one matters.
  bool one_is_enough(double size, double c, double tol) {
    --trusted_;
    return on_ && trusted_ >= 0 && contraction_ * c * c * size <= tol;
  }
  // Two iterations were made, and the second increment was `rate` times the first.
  void measured(double rate, double c) {
    contraction_ = std::max(rate / (c * c), 0.3 * contraction_);
    trusted_ = static_cast<int>(REMEMBERED);
  }

private:
  bool on_;
  double contraction_ = 1.0;
  int trusted_ = 0;
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
