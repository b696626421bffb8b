// Step and order: fixed, or from the error of a step.
#pragma once

#include "newton.hpp"

namespace pinconsist {

struct Choice {
  double h;
  int k;
};

// Error control with the tolerances of [ξ | v] in a step; without tolerances, the step size is fixed.
class Tolerances {
public:
  Vec rtol_of_run, atol_of_run;
  Vec rtol, atol; // of a step
  Vec sizes;   // largest size of [ξ | v] so far
  Vec sums_up; // the sum of the errors of all steps, in tolerances of one step; or empty
  double max_step = INF;
  bool noise = true; // whether errors may count as rounding
  long rejected_by_error = 0, rejected_by_newton = 0;

  bool fixed() const { return !rtol.size(); }

  // Updates the sizes at an accepted state.
  void reached(const System &system, const Vec &p, const Vec &v) {
    if (fixed()) return;
    magnitudes(system, p, v, at_present_);
    sizes = sizes.cwiseMax(at_present_);
  }

protected:
  void fill(const System &system, const Vec &p, const Vec &v, double h, Vec &weight) const {
    magnitudes(system, p, v, weight);
    weight = weight.cwiseMax(sizes);
    weight = weight.cwiseProduct(rtol) + atol;
    const double rounding = noise ? EPS * (1.0 + largest(p)) : 0.0;
    weight.head(system.nx).array() += POSITION_ROUNDING * rounding;
    if (sums_up.size()) {
      auto allowed = weight.tail(system.nv);
      allowed += (sums_up.tail(system.nv).cwiseProduct(allowed)).cwiseMin(VELOCITY_ROUNDING * rounding / std::abs(h));
      allowed.array() += SURE * rounding * largest(v) / system.difference_step;
    }
    for (Eigen::Index i = 0; i < system.widths.size(); ++i) { // forces change over a width: it has to be resolved
      const double width = system.widths[i];
      if (std::abs(v[i]) < COARSE * width) weight[system.nx + i] = std::min(weight[system.nx + i], width);
    }
    weight = weight.cwiseInverse();
  }

private:
  static void magnitudes(const System &system, const Vec &p, const Vec &v, Vec &size) {
    size.resize(system.nx + system.nv);
    system.position_scale(p, size.head(system.nx));
    size.tail(system.nv) = v.cwiseAbs();
  }

  Vec at_present_;
};

class Control : public Tolerances {
public:
  int max_order = 1, equal_steps = 0;
  int noisy_steps = 0; // with errors that were rounding, since a longer step was last tried

  // Tolerances of a run, and the smallest of a step. With a tolerance τ of one step's error, steps of size h ~ τ^(1/(k+1))
  // sum up to τ/h ~ τ^(k/(k+1)), k being the highest order.
  void set(const Vec &relative, const Vec &absolute, int order, double rounding) {
    rtol_of_run = relative;
    atol_of_run = absolute;
    max_order = order;
    const double k = order;
    const Eigen::ArrayXd tol = relative.cwiseMax(absolute);
    const Eigen::ArrayXd share = (ACCURACY * tol).pow((k + 1.0) / k).max(rounding) / tol;
    rtol = share * relative.array();
    atol = share * absolute.array();
    sums_up = rtol.cwiseMax(atol).array().pow(-1.0 / (k + 1.0));
  }

  // Fills the weights; returns Newton's stopping size.
  double weights(const System &system, const Vec &predicted, const Vec &base, double h, Vec &weight) const {
    if (fixed()) return rounding_weights(system, predicted, weight);
    fill(system, base, predicted.segment(system.nx, system.nv), h, weight);
    return NEWTON_FACTOR;
  }

  double error(const Attempt &step, int k) const { return fixed() ? 0.0 : bdf::error_constant(k) * step.size; }

  template <class Difference>
  double error_in(const System &system, const Difference &d, int k, const Vec &weight) const {
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
    double best_factor = -1.0, lower_factor = -1.0;
    int best = k;
    for (int order = std::max(1, k - 1); order <= std::min(max_order, k + 1); ++order) {
      const double value = order == k ? error : error_in(system, Z.row(order + 1).transpose(), order, weight);
      const double factor = std::pow(std::max(value, 1e-10), -1.0 / (order + 1));
      if (order == k - 1) lower_factor = factor;
      if (factor > best_factor) {
        best_factor = factor;
        best = order;
      }
    }
    if (k > 2 && lower_factor > LOWER_ORDER * best_factor) {
      best_factor = lower_factor;
      best = k - 1;
    }
    const double factor = std::min(MAX_FACTOR, SAFETY * best_factor);
    if (best == k && 1.0 <= factor && factor < 1.1) return {h, k};
    equal_steps = 0;
    return {h * std::min(std::max(factor, MIN_FACTOR), max_step / std::abs(h)), best};
  }

  // The step after one with an error that is rounding: as long as the longer one tried before, sometimes twice as long.
  double after_rounding(double h, double tried) {
    restart();
    double length = std::max(std::abs(h), tried);
    if (++noisy_steps > static_cast<int>(PROBING)) {
      noisy_steps = 0;
      length = std::min(2.0 * length, std::max(length, max_step));
    }
    return std::copysign(length, h);
  }

  void restart() { equal_steps = 0; }
};

// The step size from the error estimate, by Gustafsson's prediction; the number of stages from the rate of Newton's iteration.
class RadauControl : public Tolerances {
public:
  bool chooses = false; // the number of stages
  int s = 0;            // of the next step

  // Tolerances of a run; 0 stages: their number is chosen.
  void set(const Vec &relative, const Vec &absolute, int stages) {
    rtol_of_run = relative;
    atol_of_run = absolute;
    chooses = stages == 0;
    use(chooses ? static_cast<int>(FIRST_STAGES) : stages);
  }

  // Continue with so many stages. The estimate falls like hᵉ, the error of a run like h²ˢ⁻¹: this determines the
  // tolerance of the estimate. Errors of Newton's iteration add up, and do not fall with the order.
  void use(int stages) {
    s = stages;
    calm_ = failures_ = 0;
    restart();
    if (!rtol_of_run.size()) return; // a fixed step
    const double power = exponent() / (2.0 * s - 1.0);
    const Eigen::ArrayXd tol = rtol_of_run.cwiseMax(atol_of_run);
    const Eigen::ArrayXd share = (STAGE_ACCURACY * tol).pow(power) / tol;
    rtol = share * rtol_of_run.array();
    atol = share * atol_of_run.array();
    const double smallest = std::max(rtol_of_run.minCoeff(), atol_of_run.minCoeff());
    slack_ = std::pow(STAGE_ACCURACY * smallest, power) / smallest;
    newton_factor_ = std::min(s > 5 ? STAGE_NEWTON_OF_MOST : STAGE_NEWTON, STAGE_LEFT / slack_);
  }
  void restart() { last_h_ = 0.0; }

  // Fills the weights; returns Newton's stopping size.
  double weights(const System &system, const Vec &p, const Vec &v, Vec &weight) const {
    if (fixed()) {
      Vec y = Vec::Zero(system.nx + system.nv);
      if (system.vector_like) y.head(system.nx) = p;
      y.tail(system.nv) = v;
      return rounding_weights(system, y, weight);
    }
    fill(system, p, v, INF, weight);
    return newton_factor_;
  }

  // After an accepted step: more stages if Newton has not failed for a while, and if the step was not cut.
  void choose_after_step(bool cut) {
    if (++calm_ < CALM || cut) return;
    failures_ = 0;
    const bool few = s < FIRST_STAGES;
    const int more = static_cast<int>(few ? FIRST_STAGES : MOST_STAGES);
    const bool worth = few || rtol_of_run.minCoeff() <= MOST_STAGES_BELOW;
    if (chooses && worth && more != s) use(more);
  }
  // After Newton failed or a step shrank by MIN_FACTOR: fewer stages if that also happened shortly before.
  void choose_after_failure() {
    calm_ = 0;
    const int fewer = static_cast<int>(s > FIRST_STAGES ? FIRST_STAGES : FEWEST_STAGES);
    if (++failures_ >= 2 && chooses && fewer != s) use(fewer);
  }

  double after_failure(double h) {
    ++rejected_by_newton;
    restart();
    return AFTER_FAILURE * h;
  }
  double after_rejection(double h, double error) {
    ++rejected_by_error;
    return h * std::max(MIN_FACTOR, STAGE_SAFETY * std::pow(error, -1.0 / exponent()));
  }
  double next_step(double h, double error) {
    error = std::max(error, 1e-10);
    double factor = std::pow(error, -1.0 / exponent());
    if (last_h_ != 0.0)
      factor *= std::min(1.0, std::abs(h / last_h_) * std::pow(last_error_ / error, 1.0 / exponent()));
    const double growth = last_h_ == 0.0 ? MAX_FACTOR : STAGE_GROWTH;
    last_h_ = h;
    last_error_ = std::max(error, 1e-2);
    factor = std::min(growth, std::max(MIN_FACTOR, STAGE_SAFETY * factor));
    return h * std::min(factor, max_step / std::abs(h));
  }

  // The tolerance of the estimate over that of the run.
  double slack() const { return slack_; }
  // The power of h by which the error estimate falls.
  int exponent() const { return s >= 3 ? s + 2 : s + 1; }

private:
  double slack_ = 1.0, newton_factor_ = 0.0;
  double last_h_ = 0.0, last_error_ = 0.0; // of the last step, 0 if there is none
  int calm_ = 0, failures_ = 0;            // steps since the stages changed or Newton failed; failures until CALM such steps
};

} // namespace pinconsist
