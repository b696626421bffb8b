// The twins of dae/foresight.py and dae/reuse.py.
#pragma once

#include <algorithm>
#include <cmath>

namespace pinconsist {

constexpr int REMEMBERED = 20;
constexpr double CLOSED = 1e-15, HIDDEN = 7.0, ROUNDING = 2e-12;
constexpr double WORTH = 32.0, WIDEST = 2.0;

class Foresight {
public:
  void forget() { trusted_ = looks_ = 0; }

  bool one_is_enough(double size, double c, double tol) {
    --trusted_;
    return trusted_ >= 0 && contraction_ * c * c * size <= tol;
  }
  void measured(double rate, double c) {
    contraction_ = std::max(rate / (c * c), 0.3 * contraction_);
    trusted_ = REMEMBERED;
  }
  bool stays_closed(double size, double c, double tol) {
    --looks_;
    const double moved = std::abs(c) * size, allowed = HIDDEN * tol;
    const bool foreseen = looks_ >= 0 && allowed >= least_;
    return foreseen && gap_ * moved * moved <= CLOSED && hidden_ * moved <= allowed;
  }
  double closing_rate(double size, double c, double moved) const {
    return moved != 0.0 ? std::min(1.0, 2.0 * gap_ * c * c * size * size / moved) : 0.0;
  }
  // `shift` and `speed`: root mean squares of the weighted shift of the velocities, and of themselves.
  void looked(double gap, double shift, double speed, double size, double c) {
    const double moved = std::abs(c) * size == 0.0 ? 1.0 : std::abs(c) * size;
    gap_ = gap / (moved * moved);
    hidden_ = shift / moved;
    looks_ = REMEMBERED;
    least_ = ROUNDING * speed;
  }

private:
  double contraction_ = 1.0, gap_ = 0.0, hidden_ = 0.0, least_ = 0.0;
  int trusted_ = 0, looks_ = 0;
};

class Reuse {
public:
  explicit Reuse(int nv) : possible_(nv >= WORTH), price_(nv / WORTH) {}

  void forget() { known_ = false; }

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
    if (kept_) { // the old matrix was tried in vain, its iterations are lost
      cost_ += iterations_;
      iterations_ = 0;
      kept_ = false;
    }
    if (cost_ > first_ * steps_) paused_ = REMEMBERED;
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
