// dae/radau_stepper.py: a run of Radau IIA, and the loop around it.
#pragma once

#include "index1.hpp"
#include "radau.hpp"
#include "stepper.hpp"

#include <map>

namespace pinconsist {

// The step from the error estimate, and Gustafsson's prediction of the next one; none where the step is fixed.
class RadauControl {
public:
  Vec rtol, atol;
  double max_step = INF;
  long rejected_by_error = 0, rejected_by_newton = 0;

  bool fixed() const { return !rtol.size(); }
  void restart() { last_h_ = 0.0; }

  double after_failure(double h) {
    ++rejected_by_newton;
    restart();
    return STAGE_AFTER_FAILURE * h;
  }
  double after_rejection(int s, double h, double error) {
    ++rejected_by_error;
    return h * std::max(MIN_FACTOR, STAGE_SAFETY * std::pow(error, -1.0 / exponent(s)));
  }
  double next_step(int s, double h, double error) {
    error = std::max(error, 1e-10);
    double factor = std::pow(error, -1.0 / exponent(s));
    if (last_h_ != 0.0)
      factor *= std::min(1.0, std::abs(h / last_h_) * std::pow(last_error_ / error, 1.0 / exponent(s)));
    const double growth = last_h_ == 0.0 ? MAX_FACTOR : STAGE_GROWTH;
    last_h_ = h;
    last_error_ = std::max(error, 1e-2);
    factor = std::min(growth, std::max(MIN_FACTOR, STAGE_SAFETY * factor));
    return h * std::min(factor, max_step / std::abs(h));
  }

  static int exponent(int s) { return s >= 3 ? s + 2 : s + 1; }

private:
  double last_h_ = 0.0, last_error_ = 0.0; // of the last step, 0 where there is none
};

// What accepted steps leave, one entry a step.
struct RadauBatch {
  int steps = 0;
  std::vector<double> t, h, p, v, lam, W, U;
  std::vector<int> k;
};

class RadauStepper {
public:
  // The state of the run; names as in dae/radau_stepper.py.
  double t = 0.0, h = 0.0, used_h = 0.0;
  int s = 0, used_s = 0;
  Vec p, v, a, lam;
  double start = 0.0;
  long taken = 0, steps = 0; // of fixed steps
  Mat turns;
  RadauControl control;
  StageNewton newton;
  std::map<int, RadauTable> tables;
  std::map<int, double> newton_factors;

  RadauStepper(System &system, const Switches &switches)
      : newton(system, switches), system_(system), kkt_(system.nv, system.nc), index1_(system) {}

  // A step with an error of FIRST_ERROR, from the time in which the acceleration changes by as much as it is.
  double first_step(double t_end) {
    const double limit = std::abs(t_end - t), tiny = 1e-300, near = FIRST_REACH * (1.0 + largest(p));
    weights();
    const auto size = [&](const Vec &x) {
      return std::sqrt(x.cwiseProduct(weight_.tail(system_.nv)).squaredNorm() / system_.nv);
    };
    double trial = std::min({limit, near / std::max(largest(v), tiny), std::sqrt(near / std::max(largest(a), tiny))});
    double change = INF, most = 1.0;
    for (int i = 0;; ++i) {
      const double step = std::copysign(trial, t_end - t);
      v1_ = v + step * a;
      shift_ = step * system_.rate(t, p, 0.5 * (v + v1_));
      system_.integrate(p, shift_, p1_);
      if (index1_.acceleration(t + step, p1_, v1_, moved_, lam_) && moved_.allFinite() && lam_.allFinite()) {
        change = size(moved_ - a);
        most = std::max(size(a), size(moved_));
      } else {
        change = INF;
        most = 1.0;
      }
      if (i + 1 == static_cast<int>(FIRST_TRIALS) || change <= FIRST_CHANGE * most) break;
      trial *= 0.25;
    }
    const double time = std::min(limit, trial * most / std::max(change, tiny));
    const double part = std::pow(FIRST_ERROR / std::max(most * time, tiny), 1.0 / control.exponent(s));
    const double least = std::max(shortest_step(t), shortest_step(t_end));
    return std::copysign(std::max(std::min(time * std::min(1.0, part), control.max_step), least), t_end - t);
  }

  void begin_anew() {
    control.restart();
    newton.forget();
    headway_.restart(t, t);
    shaped_ = false;
  }

  Failure run(double t_end, long most, bool keep_stages, RadauBatch &out) {
    const auto begun = std::chrono::steady_clock::now();
    while (out.steps < most && t != t_end) {
      const Failure failure = advance(t_end);
      if (failure != Failure::none) return failure;
      record(keep_stages, out);
      if (std::chrono::steady_clock::now() - begun > std::chrono::duration<double>(PATIENCE)) break;
    }
    return Failure::none;
  }

private:
  Failure advance(double t_end) {
    double t_next, error, smaller;
    while (true) {
      t_next = next_time(t_end);
      Failure failure = solve(t_next);
      if (failure == Failure::none) {
        failure = land(t_next, error);
        if (failure != Failure::none) return failure;
        if (error <= 1.0) break;
        smaller = control.after_rejection(s, h, error);
        keep_shape();
      } else {
        if (fixed()) return failure;
        smaller = control.after_failure(h);
        shaped_ = false;
      }
      if (headway_.setback() || std::abs(smaller) < shortest_step(t))
        return failure != Failure::none ? failure : Failure::error_test;
      h = smaller;
    }
    keep_shape();
    used_h = newton.h;
    used_s = s;
    t = t_next;
    std::swap(p, p1_);
    std::swap(v, v1_);
    ++taken;
    if (!fixed()) h = control.next_step(s, newton.h, error);
    headway_.reached(t);
    return Failure::none;
  }

  // The stages of a step to t_next.
  Failure solve(double t_next) {
    const RadauTable &table = tables.at(s);
    if (newton.table != &table) newton.use(table);
    newton.t = t;
    newton.h = t_next - t;
    newton.p = p;
    newton.v = v;
    if (!shaped_) newton.W = a.replicate(1, s);
    else predict(table);
    const double tol = weights();
    const Failure failure = newton.solve(weight_, tol);
    if (failure != Failure::none) return failure;
    for (int i = 0; i < s && turns.rows(); ++i)
      if (bdf::fastest_turn(turns, newton.xi.col(i)) > MAX_CHART_TURN) return Failure::turns_too_far;
    return Failure::none;
  }

  // The polynomial of the accelerations of the last step, led on.
  void predict(const RadauTable &table) {
    const int n = shape_table_->s;
    legendre_.resize(n, s);
    for (int i = 0; i < s; ++i) {
      const double x = 2.0 * (newton.time(i) - shape_t_) / shape_h_ - 1.0;
      legendre_(0, i) = 1.0;
      if (n > 1) legendre_(1, i) = x;
      for (int j = 2; j < n; ++j)
        legendre_(j, i) = ((2 * j - 1) * x * legendre_(j - 1, i) - (j - 1) * legendre_(j - 2, i)) / j;
    }
    values_ = shape_table_->modes.transpose().lazyProduct(legendre_);
    newton.W = shape_W_.lazyProduct(values_);
  }

  void keep_shape() {
    shaped_ = true;
    shape_t_ = newton.t;
    shape_h_ = newton.h;
    shape_W_ = newton.W;
    shape_table_ = newton.table;
  }

  double weights() {
    if (fixed()) {
      Vec y = Vec::Zero(system_.nx + system_.nv);
      y.tail(system_.nv) = v;
      return rounding_weights(system_, y, weight_);
    }
    weight_.resize(system_.nx + system_.nv);
    system_.position_scale(p, weight_.head(system_.nx));
    weight_.tail(system_.nv) = v.cwiseAbs();
    weight_ = (weight_.cwiseProduct(control.rtol) + control.atol).cwiseInverse();
    return newton_factors.at(s);
  }

  // The end of a step: one factorisation at the last stage serves the projections and the error estimate.
  Failure land(double t_next, double &error) {
    const int nv = system_.nv, nc = system_.nc, last = s - 1, modes = fixed() ? 0 : s < 3 ? 1 : 3;
    const double t1 = newton.time(last);
    p1_ = newton.P.col(last);
    v1_ = newton.V.col(last);
    ++newton.nlu;
    if (const Mat *M = newton.mass_at_end()) kkt_.A() = *M;
    else system_.mass_matrix(t1, p1_, v1_, kkt_.A());
    estimate(modes);
    rhs_.setZero(nv + nc, 2 + modes);
    bool closed = false;
    for (int turn = 0; turn < static_cast<int>(CLOSINGS) && !closed; ++turn) {
      system_.constraint(t1, p1_, v1_);
      closed = largest(system_.phi) <= CLOSED * (1.0 + largest(p1_));
      rhs_.leftCols(2).setZero();
      rhs_.col(0).tail(nc) = system_.rho;
      rhs_.col(1).tail(nc) = system_.phi;
      if (turn == 0) {
        for (int m = 0; m < modes; ++m) rhs_.col(2 + m).tail(nc) = system_.W.lazyProduct(modes_.col(m));
        if (!kkt_.solve_new(system_.W, system_.G_transposed(), 1.0, rhs_, 0)) return Failure::singular;
        for (int m = 0; m < modes && nc < nv; ++m) modes_.col(m) -= rhs_.col(2 + m).head(nv); // else none is free
        rhs_.conservativeResize(nv + nc, 2);
      } else {
        kkt_.solve(rhs_, 1.0, 0);
      }
      v1_ -= rhs_.col(0).head(nv);
      if (closed) break;
      shift_ = -system_.moved_by(t1, p1_, v1_, rhs_.col(1).head(nv));
      system_.integrate(p1_, shift_, moved_);
      std::swap(p1_, moved_);
    }
    if (!closed) {
      system_.constraint(t1, p1_, v1_);
      if (largest(system_.phi) > rounding_gap(p1_, system_.G_transposed())) return Failure::not_converged;
    }
    error = fixed() ? 0.0 : error_of(modes);
    if (error > 1.0) return Failure::none; // a and λ of a rejected step are of no use
    return index1_.acceleration_after_constraint(t_next, p1_, v1_, a, lam) ? Failure::none : Failure::singular;
  }

  // What the error is estimated from: the highest modes of the accelerations.
  void estimate(int modes) {
    const Mat &W = newton.W, &of = newton.table->modes;
    modes_.resize(system_.nv, modes);
    if (modes == 3) {
      for (int m = 0; m < modes; ++m) modes_.col(m) = W.lazyProduct(of.row(s - 1 - m).transpose());
    } else if (modes == 1) { // the degree is raised by the acceleration at the start
      modes_.col(0) = -a;
      for (int k = 0; k < s; ++k) modes_.col(0) += (k % 2 ? -1.0 : 1.0) * W.lazyProduct(of.row(k).transpose());
    }
  }

  double error_of(int modes) {
    if (modes == 1) return size_of(0);
    const double middle = size_of(1), before = size_of(2), most = std::max(middle, before);
    const double highest = std::max(size_of(0), most > 0.0 ? middle * middle / most : 0.0); // it may pass through zero
    const double noise = FELT * EPS * (1.0 + largest(p1_)) / std::abs(newton.h) * weight_.tail(system_.nv).maxCoeff();
    const double felt = noise * newton.table->leading;
    const double left = std::sqrt(std::max(highest * highest - felt * felt, 0.0));
    return left == 0.0 ? 0.0 : left * left / (before + LAST_MODE * left);
  }

  double size_of(int mode) {
    const int nx = system_.nx, nv = system_.nv;
    const double step = newton.h;
    double sum = modes_.col(mode).cwiseProduct(weight_.tail(nv)).squaredNorm();
    shift_ = step * system_.moved_by(newton.t + step, p1_, v1_, modes_.col(mode));
    sum += shift_.cwiseProduct(weight_.head(nx)).squaredNorm();
    return std::abs(step) * std::sqrt(sum / nv);
  }

  double next_time(double t_end) {
    if (fixed()) return taken + 1 < steps ? start + (taken + 1) * h : t_end;
    if (turns.rows()) {
      const double speed = bdf::fastest_turn(turns, system_.rate(t, p, v));
      if (speed != 0.0) h = std::copysign(std::min(std::abs(h), MAX_CHART_TURN / speed), h);
    }
    const double left = (t_end - t) / h;
    if (left >= 2.0) return t + h;
    const bool last = left < 1.0 + 1e-9;
    h = (t_end - t) / (last ? 1 : 2);
    return last ? t_end : t + h;
  }

  void record(bool keep_stages, RadauBatch &out) const {
    const auto put = [](std::vector<double> &to, const auto &x) { to.insert(to.end(), x.data(), x.data() + x.size()); };
    ++out.steps;
    out.t.push_back(t);
    out.h.push_back(used_h);
    out.k.push_back(2 * used_s - 1);
    put(out.p, p);
    put(out.v, v);
    put(out.lam, lam);
    if (!keep_stages) return;
    put(out.W, newton.W);
    put(out.U, newton.rates());
  }

  bool fixed() const { return control.fixed(); }

  System &system_;
  KKT kkt_;
  Projection index1_;
  Headway headway_;
  bool shaped_ = false;
  double shape_t_ = 0.0, shape_h_ = 0.0;
  const RadauTable *shape_table_ = nullptr;
  Mat shape_W_, legendre_, values_, modes_, rhs_;
  Vec weight_, p1_, v1_, moved_, shift_, lam_;
};

} // namespace pinconsist
