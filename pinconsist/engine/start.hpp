// The first history of BDF: equidistant states on steps of Radau IIA.
//
// A multistep method that starts at order 1 needs tiny first steps, and at index 3 each change of order disturbs the
// multipliers. Here its first step already has full order.
#pragma once

#include "radau_stepper.hpp"

namespace pinconsist {

// Equidistant states, oldest first, and the step between them.
struct History {
  double h = 0.0;
  std::vector<double> t;
  std::vector<Vec> p, v, lam;

  void add(double time, const Vec &position, const Vec &velocity, const Vec &multipliers) {
    t.push_back(time);
    p.push_back(position);
    v.push_back(velocity);
    lam.push_back(multipliers);
  }
};

class Start {
public:
  // Stages one by one: pivots of each, where rows are nearly dependent, as a history of BDF feels their rounding.
  Start(System &system, const Switches &switches) : system_(system), radau(system, one_by_one(switches)) {}

  RadauStepper radau;

  // History::h and k + 2 states, k being the highest order of `control`, with an error of BDF within its tolerance.
  Failure adaptive(double t0, const Vec &p0, const Vec &v0, const Vec &a0, const Vec &lam0, double t_end, double first,
                   const Control &control, History &out) {
    const int k = control.max_order;
    const double shortest = START_APART * std::max(shortest_step(t0), shortest_step(t_end));
    const bool tight = control.rtol_of_run.minCoeff() <= MOST_STAGES_BELOW;
    radau.control.max_step = (k + 1) * control.max_step;
    radau.control.set((START_SHARE * control.rtol).cwiseMax(FINEST), (START_SHARE * control.atol).cwiseMax(0.1 * FINEST), 0);
    begin(t0, p0, v0, a0, lam0, t_end, tight);
    out.add(t0, p0, v0, lam0);
    Collocations made;
    double reach = 0.0, error = 0.0;
    // Its first step is cautious. Equal steps can be told apart only if they are not too short.
    while (radau.t != t_end && (std::abs(reach) < shortest || (made.size() < START_STEPS && error < START_ERROR))) {
      radau.prepare_next();
      const Failure failure = radau.advance(t_end);
      if (failure != Failure::none) return failure;
      made.push_back(radau.accurate());
      reach = (radau.t - t0) / (k + 1);
      error = error_of(made, p0, t0, reach, control);
    }
    if (std::abs(reach) < shortest) {
      out.h = t_end - t0;
      return add(made, t_end, out);
    }
    // Not farther than by the size of the position: the rounding of a far one would be in all differences.
    double h = reach * std::min(1.0, (1.0 + largest(p0)) / moved(p0, radau.p));
    if (first != 0.0) {
      h = std::copysign(std::min(std::abs(first), std::abs(h)), h);
    } else {
      h = within_tolerance(made, p0, t0, h, shortest, control);
    }
    out.h = std::copysign(std::max(std::min(std::abs(h), control.max_step), shortest), h);
    const bool before_end = (k + 1) * std::abs(out.h) < std::abs(t_end - t0);
    if (before_end) out.h = representable(t0, out.h); // else it may lead to the end exactly
    for (int i = 1; i < k + 2; ++i) {
      const Failure failure = add(made, t0 + i * out.h, out);
      if (failure != Failure::none) return failure;
    }
    return Failure::none;
  }

  // So many states at a given distance, accurate to rounding if the accelerations are smooth enough.
  Failure fixed(double t0, const Vec &p0, const Vec &v0, const Vec &a0, const Vec &lam0, double h, int number,
                History &out) {
    out.h = h;
    out.add(t0, p0, v0, lam0);
    const Vec tolerances = Vec::Constant(system_.nx + system_.nv, 0.1 * FINEST);
    radau.control.max_step = INF;
    radau.control.set(tolerances, 0.1 * tolerances, 0);
    begin(t0, p0, v0, a0, lam0, t0 + h * (number - 1), true);
    for (int i = 1; i < number; ++i) {
      const double t = t0 + i * h;
      while (radau.t != t) {
        radau.prepare_next();
        const Failure failure = radau.advance(t);
        if (failure != Failure::none) return failure;
      }
      out.add(t, radau.p, radau.v, radau.lam);
    }
    return Failure::none;
  }

private:
  static Switches one_by_one(Switches switches) {
    switches.lanes = false;
    return switches;
  }

  static constexpr double FINEST = 1e-12; // relative tolerance below which the steps of Radau would follow rounding

  // A run of Radau at the tolerances of its control.
  void begin(double t0, const Vec &p0, const Vec &v0, const Vec &a0, const Vec &lam0, double t_end, bool tight) {
    if (tight) radau.control.use(static_cast<int>(MOST_STAGES));
    radau.control.sizes = Vec::Zero(system_.nx + system_.nv);
    radau.begin_anew(t0, p0, v0, a0, lam0, t_end);
  }

  // The largest step up to h with which the error of BDF is allowed.
  double within_tolerance(const Collocations &made, const Vec &p0, double t0, double h, double shortest, const Control &control) {
    const int k = control.max_order;
    double error = error_of(made, p0, t0, h, control);
    while (error > START_ERROR && std::abs(h) > shortest) {
      const double factor = std::max(MIN_FACTOR, SAFETY * std::pow(START_ERROR / error, 1.0 / (k + 1)));
      const double smaller = error_of(made, p0, t0, factor * h, control);
      if (smaller > error * std::pow(factor, SLOW * (k + 1))) break; // it is rounding
      h *= factor;
      error = smaller;
    }
    return h;
  }

  // The largest distance of a coordinate between two positions.
  double moved(const Vec &from, const Vec &to) const {
    Vec xi(system_.nx);
    if (system_.vector_like) xi = to - from;
    else system_.difference(from, to, xi);
    return std::max(largest(xi), 1e-300);
  }

  static const Collocations::value_type &holder_of(const Collocations &made, double t) {
    size_t i = 0;
    while (i + 1 < made.size() && (made[i + 1]->shape.t - t) * made[i]->shape.h < 0.0) ++i;
    return made[i];
  }

  Failure add(const Collocations &made, double t, History &out) {
    Sampler &at = radau.sampler;
    if (!at.sample(holder_of(made, t), t)) return Failure::singular;
    out.add(t, at.p, at.v, at.lam);
    return at.p.allFinite() && at.v.allFinite() && at.lam.allFinite() ? Failure::none : Failure::not_finite;
  }

  // The local error of BDF on states at this distance.
  double error_of(const Collocations &made, const Vec &p0, double t0, double h, const Control &control) {
    const int k = control.max_order, nx = system_.nx;
    Sampler &at = radau.sampler;
    Table rows(k + 2, nx + system_.nv); // the last state first
    Vec xi(nx);
    for (int i = 0; i < k + 2; ++i) {
      const double t = t0 + i * h;
      at.look(holder_of(made, t), t, false);
      if (system_.vector_like) xi = at.p;
      else system_.difference(p0, at.p, xi);
      rows.row(k + 1 - i) << xi.transpose(), at.v.transpose();
    }
    const Vec size = rows.cwiseAbs().colwise().maxCoeff().transpose();
    const Vec weight = (control.atol + control.rtol.cwiseProduct(size)).cwiseInverse();
    const Vec last = (bdf::differences(k + 1).row(k + 1) * rows).transpose();
    return control.error_in(system_, last, k, weight);
  }

  System &system_;
};

} // namespace pinconsist
