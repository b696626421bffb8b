// What the runs of both methods share: the loop around the steps, the end of the interval, recorded steps.
#pragma once

#include "control.hpp"
#include "signs.hpp"

#include <chrono>
#include <optional>

namespace pinconsist {

template <class Numbers> void put(std::vector<double> &to, const Numbers &x) {
  to.insert(to.end(), x.data(), x.data() + x.size());
}

// Accepted steps, one entry per step, with their polynomials; the numbers of steps before jumps of forces, and λ there.
template <class Curve> struct StepBatch {
  int steps = 0;
  std::vector<double> t, h, p, v, lam, lam_after;
  std::vector<int> order, jumps;
  Curve curve;
};

// The time of an event and the state there.
struct Located {
  double t;
  Vec p, v, lam;
};

// The accuracy, s, of a time.
inline double exactly(double t) { return 4e-16 * std::max(1.0, std::abs(t)); }

// An interval of time and the values of an event's function at its ends.
struct Bracket {
  double begin, before, end, after;
};

// Shorten an interval until g has its sign before the zero at the beginning too; false if it never has.
template <class G> bool narrowed(const G &g, Bracket &of) {
  const double left = of.begin;
  while (std::abs(of.end - left) > shortest_step(of.end)) {
    const double t = left + SHORTER * (of.end - left), value = g(t);
    if (value * of.before > 0.0) {
      of.begin = t;
      of.before = value;
      return true;
    }
    of.end = t;
    of.after = value;
  }
  return false;
}

// The zero of g between a and b, where its signs differ, and its value there. By inverse quadratic interpolation or
// bisection, chosen as by Chandrupatla (Adv. Eng. Softw. 28, 1997); if that takes long, by bisection alone.
template <class G> std::pair<double, double> zero(const G &g, double a, double fa, double b, double fb, double near) {
  double part = fa / (fa - fb);
  if (std::isnan(part)) part = 0.5; // infinite values
  for (int tries = 1;; ++tries) {
    const double least = 0.5 * near / std::abs(b - a);
    const double t = a + std::min(std::max(part, least), 1.0 - least) * (b - a), f = g(t);
    double c = a, fc = fa;
    if (!(f * fa > 0.0)) {
      std::swap(c, b);
      std::swap(fc, fb);
    }
    a = t;
    fa = f;
    if (fa == 0.0 || std::abs(b - a) <= near) break;
    const double x = (a - b) / (c - b), y = (fa - fb) / (fc - fb);
    part = tries < HALVING && y * y < x && (1.0 - y) * (1.0 - y) < 1.0 - x
               ? fa / (fa - fb) * fc / (fc - fb) - (c - a) / (b - a) * fa / (fc - fa) * fb / (fb - fc)
               : 0.5;
  }
  return std::abs(fa) < std::abs(fb) ? std::pair{a, fa} : std::pair{b, fb};
}

// Method has `advance`, `prepare_next`, `shorten`, `order`, `velocity`, `multipliers`, `keep`, `looks`, `look`, `control`.
template <class Method, class Curve> class Run {
public:
  // The state of the run: time reached, next step and the one before, position.
  double t = 0.0, h = 0.0, used_h = 0.0;
  Vec p;
  Mat turns;
  double first = 0.0; // size of the first step; 0 if it is chosen
  // For fixed steps: their wanted size, where they begin, how many were made, and of how many.
  double step = 0.0, start = 0.0;
  long taken = 0, steps = 0;

  // Divide the time up to `t_end` into fixed steps of the wanted size or slightly smaller, and at least so many.
  void divide(double t_end, long least = 1) {
    steps = std::max(least, std::lround(std::ceil(std::abs(t_end - t) / step - 1e-9)));
    start = t;
    taken = 0;
    h = (t_end - t) / steps;
  }

  // Steps that Python has not read yet.
  StepBatch<Curve> unread;

  // Continue to t_end, after a jump of forces if `jumped`; the steps are added to `unread`.
  Failure reach(double t_end, long most, bool jumped, const nb::object &forces) {
    const Failure failure = jumped ? jump_here(unread) : Failure::none;
    return failure != Failure::none ? failure : run(t_end, unread.steps + most, false, nullptr, nb::none(), forces, unread);
  }

  // Accepted steps towards t_end, until there are `most`, or until `signs`, if not null, have changed. `sees`, if not
  // None, is called with each and may end them; `forces` gives the times before t_end at which forces jump.
  Failure run(double t_end, long most, bool with_curve, Signs *signs, const nb::object &sees, const nb::object &forces,
              StepBatch<Curve> &out) {
    const auto begun = std::chrono::steady_clock::now();
    double until = forces.is_none() ? t_end : next_change(forces, t_end);
    bool ended = false;
    const auto leave = [&](double t1, const Vec &p1, const Vec &v1, const Vec &lam1) { // whether the run continues
      record(t1, p1, v1, lam1, out);
      ended = ended || (!sees.is_none() && nb::cast<bool>(sees(t1, array(p1), array(v1), array(lam1), self().order())));
      return !ended;
    };
    if (with_curve) self().reserve(most, out.curve);
    while (out.steps < most && t != t_end && !ended) {
      Failure failure = Failure::none;
      if (t == until) {
        failure = change(forces, out);
        if (failure != Failure::none) return failure;
        until = next_change(forces, t_end);
      }
      if (std::exchange(resumes_, false)) {
        failure = self().resume(until, leave);
        if (failure != Failure::none) return failure;
      } else {
        self().prepare_next();
        failure = self().advance(until);
        if (failure != Failure::none) return failure;
        bool stop = false;
        if (signs) {
          nb::gil_scoped_acquire holds; // once for all looks
          unseen_ = self().looks();
          failure = watched(*signs);
          ended = signs->changed;
          stop = !ended && signs->interrupted();
        }
        if (with_curve) self().keep(out.curve);
        leave(t, p, self().velocity(), self().multipliers());
        if (failure != Failure::none) return failure;
        if (stop) interrupt();
      }
      if (std::chrono::steady_clock::now() - begun > std::chrono::duration<double>(PATIENCE)) break;
    }
    return Failure::none;
  }

  // Evaluate the signs in the unseen part of the last step, until one has changed.
  Failure watched(Signs &signs) {
    signs.changed = false;
    while (unseen_ > 0 && !signs.changed) {
      const double at = t - used_h * (unseen_ - 1) / self().looks();
      if (signs.at_zero() && !self().look(signs, signs.end + NUDGE * (at - signs.end))) return Failure::singular;
      if (signs.changed) break;
      --unseen_;
      if (!self().look(signs, at)) return Failure::singular;
      const double between = signs.changed ? NOT_A_NUMBER : signs.doubtful();
      if (std::isnan(between)) continue;
      signs.back();
      if (!self().look(signs, between)) return Failure::singular;
      if (signs.changed) ++unseen_;
      else if (!self().look(signs, at)) return Failure::singular;
    }
    return Failure::none;
  }

protected:
  explicit Run(System &system) : system_(system) {}

  bool begun_ = false;   // the run has begun before
  bool resumes_ = false; // forces may jump at the current time
  int unseen_ = 0; // remaining evaluations in the last step

  bool fixed() const { return static_cast<const Method &>(*this).control.fixed(); }

  // The time of the next step; the last steps of a variable run are fitted to the end.
  double next_time(double t_end) {
    if (fixed()) return taken + 1 < steps ? start + (taken + 1) * h : t_end;
    const double left = (t_end - t) / h;
    if (left >= 2.0) return t + h;
    const bool last = left < 1.0 + 1e-9;
    self().shorten((t_end - t) / (last ? 1 : 2)); // two equal steps avoid a tiny last one
    return last ? t_end : t + h;
  }

  System &system_;
  Headway headway_;

private:
  Method &self() { return static_cast<Method &>(*this); }

  [[noreturn]] static void interrupt() {
    nb::gil_scoped_acquire holds;
    PyErr_SetNone(PyExc_KeyboardInterrupt);
    throw nb::python_error();
  }

  double next_change(const nb::object &forces, double t_end) const {
    nb::gil_scoped_acquire holds;
    return nb::cast<double>(forces.attr("next_change")(t, t_end));
  }

  // Forces may jump here: the state stays the same, and the multipliers jump with the forces. If neither they nor their
  // rates do, the run goes on.
  Failure change(const nb::object &forces, StepBatch<Curve> &out) {
    nb::gil_scoped_acquire holds;
    const nb::object changed = forces.attr("change")(t, array(p), array(self().velocity()));
    if (changed.is_none()) return Failure::none;
    resumes_ = true;
    return nb::cast<bool>(changed) ? jump_here(out) : Failure::none;
  }

  Failure jump_here(StepBatch<Curve> &out) {
    const Failure failure = self().jump();
    if (failure != Failure::none) return failure;
    resumes_ = true;
    out.jumps.push_back(out.steps);
    put(out.lam_after, self().multipliers());
    return failure;
  }

  void record(double t1, const Vec &p1, const Vec &v1, const Vec &lam1, StepBatch<Curve> &out) {
    ++out.steps;
    out.t.push_back(t1);
    out.h.push_back(used_h);
    out.order.push_back(self().order());
    put(out.p, p1);
    put(out.v, v1);
    put(out.lam, lam1);
  }
};

} // namespace pinconsist
