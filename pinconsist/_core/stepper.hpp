// The twin of dae/stepper.py, and the loop around it: a stretch of accepted steps in one call.
#pragma once

#include "stepsize.hpp"

#include <chrono>

namespace pinconsist {

constexpr double SMALLEST = 16.0;
constexpr double NEAR_ROUNDING = 1e-9, HALF = 1e-8, SLOW = 0.5, PROGRESS = 1e-6;
constexpr int SETBACKS = 100;
constexpr std::chrono::milliseconds PATIENCE{50}; // after which Python is asked whether somebody interrupts

inline double spacing(double t) { return std::nextafter(std::abs(t), INF) - std::abs(t); }

// What a stretch of accepted steps leaves, one column a step.
struct Stretch {
  int steps = 0;
  std::vector<double> t, h, p, v, lam, base, Z;
  std::vector<int> k;
};

class Stepper {
public:
  // The state of the run; names as in dae/stepper.py.
  double t = 0.0, h = 0.0, t_old = 0.0, used_h = 0.0;
  int k = 1, used_k = 0;
  Vec p, y, base;
  Table Z;
  Choice choice{0.0, 1};
  long taken = 0;
  // Of fixed steps.
  double start = 0.0, step = 0.0;
  long steps = 0;
  Mat turns;
  Control control;
  Newton newton;

  Stepper(System &system, bool correct) : newton(system, correct), system_(system), projection_(system) {}

  // Accepted steps towards t_end, at most `most`; `prepared` where the first needs no change of step any more.
  Failure run(double t_end, long most, bool keep_tables, Stretch &out) {
    const auto begun = std::chrono::steady_clock::now();
    while (out.steps < most && t != t_end) {
      prepare_next();
      const Failure failure = advance(t_end);
      if (failure != Failure::none) return failure;
      record(keep_tables, out);
      if (std::chrono::steady_clock::now() - begun > PATIENCE) break;
    }
    return Failure::none;
  }

  // Nothing is known of what comes: the run starts, or starts again.
  void begin_anew(double at) {
    control.restart();
    newton.forget();
    since_ = mark_ = at;
    felt_ = 0.0;
    trusted_ = setbacks_ = 0;
  }

private:
  Failure advance(double t_end) {
    const bool charted = turns.rows() > 0;
    if (charted && fixed() && std::abs(h) > longest_step(velocity(), k)) return Failure::turns_too_far;
    double error, t_next, tried_h = 0.0, tried_error = 0.0;
    int order;
    while (true) {
      t_next = next_time(t_end);
      order = k;
      bdf::predict(system_, k, base, Z, predicted_, psi_);
      const double tol = control.weights(system_, predicted_, weight_);
      newton.attempt(t_next, base, psi_, predicted_, h / bdf::alpha(k), weight_, tol, attempt_);
      double smaller;
      if (attempt_.failure != Failure::none) {
        if (fixed()) return attempt_.failure;
        smaller = control.after_failure(h);
      } else {
        error = control.error(attempt_, k);
        if (error <= 1.0 || is_rounding(t_next, error, tried_h, tried_error)) break;
        tried_h = std::abs(h);
        tried_error = error;
        const Choice again = control.after_rejection(system_, Z, attempt_.change, k, h, error, weight_);
        smaller = again.h;
        k = again.k;
      }
      newton.forget();
      ++setbacks_;
      if (std::abs(smaller) < SMALLEST * spacing(t) || setbacks_ > SETBACKS)
        return attempt_.failure != Failure::none ? attempt_.failure : Failure::error_test;
      rescale(smaller, order);
    }
    bdf::advance(k, attempt_.change, Z);
    t_old = t;
    t = t_next;
    std::swap(p, attempt_.p);
    std::swap(y, attempt_.y);
    used_h = h;
    used_k = k;
    ++taken;
    if (error > 1.0) { // rounding: a longer step that was tried is as good
      choice = {std::copysign(std::max(std::abs(h), tried_h), h), k};
      control.restart();
    } else {
      choice = control.next_step(system_, Z, k, h, error, weight_);
    }
    --trusted_;
    if (std::abs(t - mark_) > PROGRESS * std::abs(t - since_)) mark_ = t, setbacks_ = 0;
    return Failure::none;
  }

  // Whether it is rounding that fails the error test, which a shorter step would feel as much.
  bool is_rounding(double t_next, double error, double longer, double its_error) {
    const double size = std::abs(h);
    if (control.rtol.minCoeff() > NEAR_ROUNDING) return false;
    const bool shown = size < longer && error >= its_error * std::pow(size / longer, SLOW * (k + 1));
    const bool known = trusted_ > 0 && size <= felt_;
    if (!(shown || known) || error > rounding_error(t_next)) return false;
    if (shown) {
      felt_ = std::max(known ? felt_ : 0.0, longer);
      trusted_ = REMEMBERED;
    }
    return true;
  }

  // Change to the step and order that the control chose.
  void prepare_next() {
    double wanted = choice.h;
    const bool charted = turns.rows() > 0 && !fixed();
    if (charted) wanted = std::copysign(std::min(std::abs(wanted), longest_step(velocity(), choice.k)), wanted);
    if (wanted != h) rescale(wanted, choice.k);
    k = choice.k;
    if (charted) slow_down();
  }

  void slow_down() {
    const double before = h;
    const auto leads_to = [&] {
      return Vec(Z.block(0, system_.nx, k + 1, system_.nv).colwise().sum().transpose());
    };
    while (longest_step(leads_to(), k) < (1.0 - 1e-9) * std::abs(h)) rescale(0.7 * h, k);
    if (h != before) control.restart();
  }

  void rescale(double wanted, int order) {
    bdf::rescale(order, wanted / h, Z);
    h = wanted;
  }

  double longest_step(const Vec &v, int order) const {
    const double speed = bdf::fastest_turn(turns, v);
    return speed != 0.0 ? bdf::MAX_CHART_TURN / ((order + 2) * speed) : INF;
  }

  double next_time(double t_end) {
    if (fixed()) return taken + 1 < steps ? start + (taken + 1) * h : t_end;
    const double left = (t_end - t) / h;
    if (left >= 2.0) return t + h;
    const bool last = left < 1.0 + 1e-9;
    rescale((t_end - t) / (last ? 1 : 2), k);
    control.restart();
    return last ? t_end : t + h;
  }

  double rounding_error(double t_next) {
    Vec noise = Vec::Zero(weight_.size());
    const Vec v = attempt_.y.segment(system_.nx, system_.nv);
    const double size = std::min(projection_.velocity_rounding(t_next, attempt_.p, v), HALF * largest(v));
    noise.tail(system_.nv).setConstant(std::ldexp(size, k + 1));
    return control.error_in(system_, noise, k, weight_);
  }

  void record(bool keep_tables, Stretch &out) const {
    const auto put = [](std::vector<double> &to, const auto &x) { to.insert(to.end(), x.data(), x.data() + x.size()); };
    ++out.steps;
    out.t.push_back(t);
    out.h.push_back(used_h);
    out.k.push_back(used_k);
    put(out.p, p);
    put(out.v, y.segment(system_.nx, system_.nv));
    put(out.lam, y.tail(system_.nc));
    if (!keep_tables) return;
    put(out.base, base);
    put(out.Z, Z);
  }

  Vec velocity() const { return y.segment(system_.nx, system_.nv); }
  bool fixed() const { return control.fixed(); }

  System &system_;
  Projection projection_;
  double since_ = 0.0, mark_ = 0.0; // start, and the time since which setbacks are counted
  int setbacks_ = 0;
  double felt_ = 0.0; // up to which length steps are known to feel rounding, and how many
  int trusted_ = 0;
  Attempt attempt_;
  Vec predicted_, psi_, weight_;
};

} // namespace pinconsist
