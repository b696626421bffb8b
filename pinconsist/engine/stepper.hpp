// A multistep run.
#pragma once

#include "run.hpp"
#include "start.hpp"

namespace pinconsist {

// Steps: their ends and sizes, the degrees of their polynomials, chart centres and tables.
struct TableCurve {
  std::vector<double> t, h, bases, tables;
  std::vector<int> degrees;
};

class Stepper : public Run<Stepper, TableCurve> {
public:
  int k = 1, used_k = 0;
  int points = 1; // of the polynomial of the last step, or of the history
  Vec y, base;
  Table Z;
  Choice choice{0.0, 1};
  Control control;
  Newton newton;

  Stepper(System &system, bool correct, const Switches &switches)
      : Run(system), newton(system, correct, switches), start_(system, switches), kkt_(system.nv, system.nc) {}

  // Start, or start again, at a state with its acceleration and multipliers. The run is at the end of the history then.
  Failure begin(double t0, const Vec &p0, const Vec &v0, const Vec &a0, const Vec &lam0, double t_end, History &past) {
    k = control.max_order;
    t = t0;
    start_.radau.turns = turns;
    Failure failure;
    if (fixed()) {
      const bool again = begun_ && std::abs(t_end - t0) > 1e-3 * step; // too few rows would make a poor interpolant
      divide(t_end, again ? k : 1);
      failure = start_.fixed(t0, p0, v0, a0, lam0, h, static_cast<int>(std::min<long>(k, steps + 1)), past);
    } else {
      failure = start_.adaptive(t0, p0, v0, a0, lam0, t_end, first, control, past);
    }
    count_start();
    if (failure != Failure::none) return failure;
    if (std::abs(past.t.back() - t_end) <= 1e-9 * std::abs(past.h)) past.t.back() = t_end; // else a tiny step would be left
    follow(past);
    return Failure::none;
  }

  // A state of the run, up to the next start.
  void stand(double t0, double step, const Vec &p0, const Vec &v0, const Vec &lam0) {
    t = t0;
    h = step;
    p = p0;
    k = control.max_order;
    y.resize(system_.nx + system_.nv + system_.nc);
    y << Vec::Zero(system_.nx), v0, lam0;
    begun_ = true;
  }

  // The state at the end of the next step, not corrected, and iterated to rounding.
  Failure trial(Vec &p1, Vec &v1) {
    Vec centre = base;
    Table table = Z;
    bdf::predict(system_, k, centre, table, predicted_, psi_);
    const double tol = rounding_weights(system_, predicted_, weight_);
    newton.attempt(t + h, centre, psi_, predicted_, h / bdf::alpha(k), weight_, tol, attempt_);
    newton.forget();
    p1 = attempt_.p;
    v1 = attempt_.y.segment(system_.nx, system_.nv);
    return attempt_.failure;
  }

  // Continue with other velocities of the history, oldest first.
  void take_velocities(const Table &velocities) {
    const auto n = velocities.rows();
    Z.block(0, system_.nx, n, system_.nv) = bdf::differences(static_cast<int>(n) - 1) * velocities.colwise().reverse();
    y = Z.row(0).transpose();
  }

  // The state within the last step, or the history.
  std::optional<Located> inside(double at) const {
    if (at == t) return Located{t, p, velocity(), multipliers()};
    Vec all = Z.row(0).transpose(), place = all.head(system_.nx);
    double basis = 1.0;
    for (int j = 1; j < points; ++j) all += (basis *= ((at - t) / used_h + j - 1) / j) * Z.row(j).transpose();
    if (system_.vector_like) place = all.head(system_.nx);
    else system_.integrate(base, all.head(system_.nx), place);
    return Located{at, place, all.segment(system_.nx, system_.nv), all.tail(system_.nc)};
  }

  // An event between the last two evaluations: its time and state.
  std::optional<Located> locate(Events &events, size_t i, double = NOT_A_NUMBER) { // steps are as accurate between their ends
    const auto g = [&](double at) {
      const Located here = *inside(at);
      return events.value(i, at, here.p, here.v, here.lam);
    };
    if (events.values[i] == 0.0) return inside(events.end);
    Bracket between{events.begin, events.before[i], events.end, events.values[i]};
    if (events.leaves(i) && !narrowed(g, between)) return inside(between.begin);
    const auto &[begin, before, end, after] = between;
    return inside(zero(g, begin, before, end, after, exactly(end)).first);
  }

  void end_at(double) {} // a step of other length has another history

  Vec multipliers() const { return y.tail(system_.nc); }

  Vec velocity() const { return y.segment(system_.nx, system_.nv); }

private:
  friend class Run<Stepper, TableCurve>;

  // Forces have jumped: λ jumps with them.
  Failure jump() {
    Vec a, lam;
    if (!index1_.acceleration(t, p, velocity(), a, lam)) return Failure::singular;
    if (!a.allFinite() || !lam.allFinite()) {
      newton.culprit_t = t, newton.culprit_p = p, newton.culprit_v = velocity();
      return Failure::not_finite;
    }
    y.tail(system_.nc) = lam;
    return Failure::none;
  }

  // Start at a state with this acceleration; the states of the history after it are left by the loop.
  Failure start(const Located &from, const Vec &a, double until) {
    History past;
    started_.clear();
    const Failure why = begin(from.t, from.p, from.v, a, from.lam, until, past);
    if (why != Failure::none) return why;
    for (size_t i = 1; i < past.t.size(); ++i) started_.push_back({past.t[i], past.p[i], past.v[i], past.lam[i]});
    return fixed() && turns.rows() && std::abs(h) > longest_step(velocity(), k) ? Failure::turns_too_far : Failure::none;
  }

  // The run starts again from here.
  Failure resume(double until) {
    State here{p, velocity()};
    if (newton.corrects) here = index1_.project(t, here.p, here.v); // constraints may be others from here on
    if (*here.failure) return Failure::singular;
    Vec a, lam;
    if (!index1_.acceleration(t, here.p, here.v, a, lam)) return Failure::singular;
    return start({t, here.p, here.v, lam}, a, until);
  }

  // Continue from a history.
  void follow(const History &past) {
    const size_t n = past.t.size();
    control.restart();
    newton.forget();
    rounding_.restart();
    on_trial_ = false;
    t = past.t.back();
    headway_.restart(past.t.front(), t);
    taken = static_cast<long>(n) - 1;
    p = base = past.p.back();
    Table rows(n, system_.nx + system_.nv + system_.nc);
    Vec xi(system_.nx);
    for (size_t i = 0; i < n; ++i) { // the last one first
      const size_t at = n - 1 - i;
      if (system_.vector_like) xi = past.p[at];
      else system_.difference(base, past.p[at], xi);
      rows.row(i) << xi.transpose(), past.v[at].transpose(), past.lam[at].transpose();
    }
    Z.setZero(bdf::ROWS, rows.cols());
    Z.topRows(n) = bdf::differences(static_cast<int>(n) - 1) * rows;
    y = Z.row(0).transpose();
    h = past.h;
    choice = {h, k};
    used_h = h;
    used_k = 0;
    points = static_cast<int>(n);
    begun_ = true;
  }

  void count_start() {
    StageNewton &of = start_.radau.newton;
    newton.nfev += std::exchange(of.nfev, 0);
    newton.njev += std::exchange(of.njev, 0);
    newton.nlu += std::exchange(of.nlu, 0);
    if (!of.culprit_p.size()) return;
    newton.culprit_t = of.culprit_t;
    newton.culprit_p = of.culprit_p;
    newton.culprit_v = of.culprit_v;
  }

  Failure advance(double t_end) {
    control.reached(system_, p, velocity());
    const bool charted = turns.rows() > 0;
    if (charted && fixed() && std::abs(h) > longest_step(velocity(), k)) return Failure::turns_too_far;
    double error, t_next, tried_h = 0.0, tried_error = 0.0;
    int order;
    bool rounding;
    while (true) {
      t_next = next_time(t_end);
      if (t_next == t) return Failure::error_test; // accepted steps have become too short, as near a pole
      order = k;
      bdf::predict(system_, k, base, Z, predicted_, psi_);
      const double tol = control.weights(system_, predicted_, base, h, weight_);
      newton.attempt(t_next, base, psi_, predicted_, h / bdf::alpha(k), weight_, tol, attempt_);
      double smaller;
      if (attempt_.failure != Failure::none) {
        if (fixed()) return attempt_.failure;
        smaller = control.after_failure(h);
      } else {
        error = control.error(attempt_, k);
        const bool noisy = error > (tried_h != 0.0 ? 1.0 : UNNOTICED) && (tried_h != 0.0 || !on_trial_);
        rounding = noisy && is_rounding(t_next, error, tried_h, tried_error);
        if (error <= 1.0 || rounding) break;
        tried_h = std::abs(h);
        tried_error = error;
        const Choice again = control.after_rejection(system_, Z, attempt_.change, k, h, error, weight_);
        smaller = again.h;
        k = again.k;
      }
      newton.forget();
      if (headway_.setback() || std::abs(smaller) < shortest_step(t))
        return attempt_.failure != Failure::none ? attempt_.failure : Failure::error_test;
      rescale(smaller, order);
    }
    bdf::advance(k, attempt_.change, Z);
    t = t_next;
    std::swap(p, attempt_.p);
    std::swap(y, attempt_.y);
    used_h = h;
    used_k = k;
    points = k + 1;
    ++taken;
    if (rounding) {
      choice = {control.after_rounding(h, tried_h), k};
    } else {
      choice = control.next_step(system_, Z, k, h, error, weight_);
    }
    // A longer step that is tried after one that would have passed must pass by itself.
    on_trial_ = rounding && error <= 1.0 && std::abs(choice.h) > std::max(std::abs(used_h), tried_h);
    rounding_.accepted();
    headway_.reached(t);
    return Failure::none;
  }

  // Whether the error of the attempt is rounding of the velocities, which a shorter step would not reduce.
  bool is_rounding(double t_next, double error, double longer, double its_error) {
    if (fixed()) return false;
    const auto size = [&](const auto &d) { return control.error_in(system_, d, k, weight_); };
    bool shows = false;
    if (longer != 0.0)
      shows = std::abs(h) < longer && error >= its_error * std::pow(std::abs(h) / longer, SLOW * (k + 1));
    else if (used_k)
      shows = size(attempt_.change - std::pow(h / used_h, k + 1) * Z.row(k + 1).transpose()) >= SUDDEN * error;
    const auto explained = [&](double velocity) {
      Vec noise = Vec::Zero(weight_.size());
      noise.tail(system_.nv).setConstant(std::ldexp(velocity, k + 1));
      return size(noise);
    };
    const Vec v = attempt_.y.segment(system_.nx, system_.nv);
    return rounding_.passes(error, shows, largest(v), explained,
                            [&] { return velocity_rounding(system_, kkt_, t_next, attempt_.p, v); });
  }

  // Change to the step size and order that the control has chosen.
  void prepare_next() {
    double wanted = choice.h;
    const bool charted = turns.rows() > 0 && !fixed();
    if (charted) wanted = std::copysign(std::min(std::abs(wanted), longest_step(velocity(), choice.k)), wanted);
    if (wanted != h) rescale(wanted, choice.k);
    k = choice.k;
    if (charted) shorten_to_charts();
  }

  void shorten_to_charts() {
    const double before = h;
    const auto leads_to = [&] {
      return Vec(Z.block(0, system_.nx, k + 1, system_.nv).colwise().sum().transpose());
    };
    while (longest_step(leads_to(), k) < (1.0 - 1e-9) * std::abs(h)) rescale(0.7 * h, k);
    if (h != before) control.restart();
  }

  void rescale(double wanted, int order) { stretch(representable(t, wanted), order); }

  void stretch(double wanted, int order) {
    bdf::rescale(order, wanted / h, Z);
    h = wanted;
  }

  double longest_step(const Vec &v, int order) const {
    const double speed = bdf::fastest_turn(turns, system_.rate(t, p, v));
    return speed != 0.0 ? MAX_CHART_TURN / ((order + 2) * speed) : INF;
  }

  void shorten(double wanted) {
    stretch(wanted, k); // not rounded: it leads to the end exactly
    control.restart();
  }

  int looks() const { return static_cast<int>(LOOKS_OF_BDF); }
  bool look(Events &events, double at) {
    const Located here = *inside(at);
    events.look(at, here.p, here.v, here.lam);
    return true;
  }

  int order() const { return used_k; }
  void keep(TableCurve &curve) {
    curve.t.push_back(t);
    curve.h.push_back(used_h);
    curve.degrees.push_back(points - 1);
    put(curve.bases, base);
    put(curve.tables, Z);
  }

  Start start_;
  RoundingTest rounding_;
  bool on_trial_ = false; // the next step is longer than the last accepted or tried one
  KKT kkt_; // of the rounding test
  Attempt attempt_;
  Vec predicted_, psi_, weight_;
};

} // namespace pinconsist
