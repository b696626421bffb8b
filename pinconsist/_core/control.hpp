// dae/control.py: step and order.
#pragma once

#include "newton.hpp"

namespace pinconsist {

struct Choice {
  double h;
  int k;
};

class Control {
public:
  // Error control with the tolerances of [ξ | v]; with none, the same step and order throughout.
  Vec rtol, atol;
  Vec sizes; // the largest that [ξ | v] have been
  int max_order = 1;
  double max_step = INF;
  int equal_steps = 0;
  bool keep_weights = true;
  long rejected_by_error = 0, rejected_by_newton = 0;

  bool fixed() const { return !rtol.size(); }

  // Fills the weights; returns Newton's stopping size.
  double weights(const System &system, const Vec &predicted, const Vec &base, double h, Vec &weight) const {
    if (fixed()) return rounding_weights(system, predicted, weight);
    if (keep_weights && equal_steps % static_cast<int>(WEIGHED)) return NEWTON_FACTOR;
    magnitudes(system, predicted, base, weight);
    weight = weight.cwiseMax(sizes).cwiseProduct(rtol) + atol;
    const double noise = NOISE * EPS * (1.0 + largest(base));
    weight.head(system.nx).array() += noise;
    weight.tail(system.nv).array() += noise / std::abs(h);
    weight = weight.cwiseInverse();
    return NEWTON_FACTOR;
  }

  // Notes how large the columns are at the state reached.
  void reached(const System &system, const Vec &y, const Vec &p) {
    if (fixed()) return;
    magnitudes(system, y, p, at_present_);
    sizes = sizes.cwiseMax(at_present_);
  }

  double error(const Attempt &step, int k) const { return fixed() ? 0.0 : bdf::error_constant(k) * step.size; }

  double error_in(const System &system, const Vec &d, int k, const Vec &weight) const {
    return fixed() ? 0.0 : bdf::error_constant(k) * weighted_norm(d, weight, system.nv);
  }

  double after_failure(double h) {
    equal_steps = 0;
    ++rejected_by_newton;
    return AFTER_FAILURE * h;
  }

  Choice after_rejection(const System &system, const Table &Z, const Vec &d, int k, double h, double error,
                         const Vec &weight) {
    equal_steps = 0;
    ++rejected_by_error;
    double factor = std::pow(error, -1.0 / (k + 1));
    if (k > 1) {
      const double lower = std::pow(error_in(system, Z.row(k).transpose() + d, k - 1, weight), -1.0 / k);
      if (lower > factor) {
        factor = lower;
        --k;
      }
    }
    return {h * std::min(1.0, std::max(MIN_FACTOR, SAFETY * factor)), k};
  }

  Choice next_step(const System &system, const Table &Z, int k, double h, double error, const Vec &weight) {
    if (fixed()) return {h, k};
    ++equal_steps;
    if (equal_steps <= k) return {h, k};
    double best_factor = -1.0;
    int best = k;
    for (int order = std::max(1, k - 1); order <= std::min(max_order, k + 1); ++order) {
      const double value = order == k ? error : error_in(system, Z.row(order + 1).transpose(), order, weight);
      const double factor = std::pow(std::max(value, 1e-10), -1.0 / (order + 1));
      if (factor > best_factor) {
        best_factor = factor;
        best = order;
      }
    }
    const double factor = std::min(MAX_FACTOR, SAFETY * best_factor);
    if (best == k && 1.0 <= factor && factor < 1.1) return {h, k};
    equal_steps = 0;
    return {h * std::min(std::max(factor, MIN_FACTOR), max_step / std::abs(h)), best};
  }

  void restart() { equal_steps = 0; }

private:
  static void magnitudes(const System &system, const Vec &y, const Vec &p, Vec &size) {
    size = y.head(system.nx + system.nv).cwiseAbs();
    if (!system.vector_like) system.position_scale(p, size.head(system.nx));
  }

  Vec at_present_;
};

} // namespace pinconsist
