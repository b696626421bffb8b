// gradients/stage_leg.py: steps of Radau IIA repeated, and derivatives propagated along them, forwards and backwards.
#pragma once

#include "radau.hpp"
#include "stage_gradient.hpp"

namespace pinconsist {

// The derivatives of λ at a state by those of the state.
class MultiplierRates {
public:
  Vec lam;

  MultiplierRates(System &system, const Parameters &parameters)
      : parameters_(parameters), system_(system), rows_(system), others_(system), index1_(system), at_(system) {}

  bool set(double t, const Vec &p, const Vec &v) {
    Mat F;
    if (!index1_.acceleration(t, p, v, a_, lam) || !at_.set(t, p, v, a_)) return false;
    K_ = at_.K;
    rows_.find_second(t, p, v, a_, lam, F, by_p_, by_v_);
    K_ -= F;
    rates_.setZero(system_.nv + system_.nc, parameters_.size());
    parameters_.each(t, p, v, a_, [&](int k, double weight, System &other) {
      rates_.col(k).head(system_.nv) += weight * (other.f - other.G_transposed().transpose() * lam);
      rates_.col(k).tail(system_.nc) += weight * others_.beta(other, t, p, v, a_);
    });
    t_ = t;
    p_ = p;
    v_ = v;
    return true;
  }

  // Those of a and λ by p and v.
  Mat linear() const {
    Mat rhs(system_.nv + system_.nc, 2 * system_.nv);
    rhs << K_, at_.D, by_p_, by_v_;
    at_.solve(rhs);
    return -rhs;
  }

  void forward(const Mat &s, Mat &of_lam) {
    const int nv = system_.nv, nc = system_.nc;
    Mat rhs = rates_;
    if (parameters_.known) parameters_.known->add_columns(t_, p_, v_, a_, rhs.topRows(nv));
    rhs.topRows(nv) += K_ * s.topRows(nv) + at_.D * s.bottomRows(nv);
    rhs.bottomRows(nc) += by_p_ * s.topRows(nv) + by_v_ * s.bottomRows(nv);
    at_.solve(rhs);
    of_lam = -rhs.bottomRows(nc);
  }

  // The transpose, of one column; adds to `rates`, (P).
  void backward(const Vec &of_lam, Vec &s, Eigen::Ref<Vec> rates) {
    const int nv = system_.nv, nc = system_.nc;
    Vec weights = Vec::Zero(nv + nc);
    weights.tail(nc) = -of_lam;
    at_.solve_transposed(weights);
    s.resize(2 * nv);
    s << K_.transpose() * weights.head(nv) + by_p_.transpose() * weights.tail(nc),
        at_.D.transpose() * weights.head(nv) + by_v_.transpose() * weights.tail(nc);
    rates += rates_.transpose() * weights;
    if (parameters_.known) parameters_.known->contract(t_, p_, v_, a_, weights.head(nv), rates);
  }

  const Vec &acceleration() const { return a_; }

private:
  const Parameters &parameters_;
  System &system_;
  RowGradients rows_, others_;
  Projection index1_;
  StatePoint at_;
  double t_ = 0.0;
  Vec p_, v_, a_;
  Mat K_, by_p_, by_v_, rates_;
};

// Each method returns the number of the step or state that is singular, or -1.
class StageDerivatives {
public:
  Parameters parameters;

  explicit StageDerivatives(System &system)
      : system_(system), motion_(system, parameters), multipliers_(system, parameters), newton_(system, Switches{}), index1_(system) {}

  // Solve steps to rounding from the accelerations W, which are updated, as are their ends (p, v).
  int again(const StageSteps &steps, double *W, double *p, double *v) {
    const int nv = system_.nv, npos = system_.npos, nx = system_.nx;
    Vec weight, y = Vec::Zero(nx + nv);
    for (int i = 0; i < steps.n; ++i) {
      const RadauTable &table = RadauTable::of.at(static_cast<int>(steps.s[i]));
      Stages &stages = newton_.stages;
      newton_.use(table);
      newton_.forget();
      stages.t = steps.t_old[i];
      stages.h = steps.h[i];
      stages.p = Eigen::Map<const Vec>(steps.p0 + static_cast<long>(i) * npos, npos);
      stages.v = Eigen::Map<const Vec>(steps.v0 + static_cast<long>(i) * nv, nv);
      stages.W = Eigen::Map<const Mat>(W, nv, table.s);
      if (system_.vector_like) y.head(nx) = stages.p;
      y.tail(nv) = stages.v;
      const double tol = rounding_weights(system_, y, weight);
      if (newton_.solve(weight, tol) != Failure::none) return i;
      const State end = index1_.project(steps.t[i], stages.P.col(table.s - 1), stages.V.col(table.s - 1));
      if (*end.failure) return i;
      Eigen::Map<Mat>(W, nv, table.s) = stages.W;
      Eigen::Map<Vec>(p + static_cast<long>(i) * npos, npos) = end.p;
      Eigen::Map<Vec>(v + static_cast<long>(i) * nv, nv) = end.v;
      W += nv * table.s;
    }
    return -1;
  }

  // Row i of `ends` from row begins[i] of S; rows are (P, nx+nv).
  int forward(const StageSteps &steps, const double *S, double *ends) {
    const int n = 2 * system_.nv, P = parameters.size();
    Mat end;
    const double *W = steps.W;
    for (int i = 0; i < steps.n; ++i) {
      if (!motion_.set(steps, i, W)) return i;
      W += system_.nv * steps.s[i];
      motion_.forward(Eigen::Map<const Mat>(S + steps.begins[i] * n * P, n, P), end);
      Eigen::Map<Mat>(ends + static_cast<long>(i) * n * P, n, P) = end;
    }
    return -1;
  }

  // The transpose, from the last step to the first: adds to rows (nx+nv) of `bars`, and to `rates`, (P).
  int backward(const StageSteps &steps, const double *given, double *bars, double *rates) {
    const int n = 2 * system_.nv;
    const double *W = steps.W;
    Vec start;
    for (int i = 0; i < steps.n; ++i) W += system_.nv * steps.s[i];
    for (int i = steps.n; i-- > 0;) {
      W -= system_.nv * steps.s[i];
      if (!motion_.set(steps, i, W)) return i;
      motion_.backward(Eigen::Map<const Vec>(given + static_cast<long>(i) * n, n), start, total(rates));
      Eigen::Map<Vec>(bars + steps.begins[i] * n, n) += start;
    }
    return -1;
  }

  // λ at states (t, p, v), and its derivatives (P, nc) from those of the states.
  int multipliers(int n, const double *t, const double *p, const double *v, const double *s, double *lam, double *of_lam) {
    const int nv = system_.nv, nc = system_.nc, P = parameters.size();
    Mat found;
    for (long i = 0; i < n; ++i) {
      if (!at(t[i], p, v, i)) return static_cast<int>(i);
      multipliers_.forward(Eigen::Map<const Mat>(s + i * 2 * nv * P, 2 * nv, P), found);
      Eigen::Map<Mat>(of_lam + i * nc * P, nc, P) = found;
      Eigen::Map<Vec>(lam + i * nc, nc) = multipliers_.lam;
    }
    return -1;
  }

  // Of the index-1 equations; null if they are singular.
  const MultiplierRates *at(double t, const Vec &p, const Vec &v) { return multipliers_.set(t, p, v) ? &multipliers_ : nullptr; }

  // The transpose: adds to `bars`, (n, nx+nv), and `rates`, (P).
  int multipliers_back(int n, const double *t, const double *p, const double *v, const double *lam, double *bars, double *rates) {
    const int nv = system_.nv, nc = system_.nc;
    Vec bar;
    for (long i = 0; i < n; ++i) {
      if (!at(t[i], p, v, i)) return static_cast<int>(i);
      multipliers_.backward(Eigen::Map<const Vec>(lam + i * nc, nc), bar, total(rates));
      Eigen::Map<Vec>(bars + i * 2 * nv, 2 * nv) += bar;
    }
    return -1;
  }

private:
  bool at(double t, const double *p, const double *v, long i) {
    const int npos = system_.npos, nv = system_.nv;
    return multipliers_.set(t, Eigen::Map<const Vec>(p + i * npos, npos), Eigen::Map<const Vec>(v + i * nv, nv));
  }
  Eigen::Map<Vec> total(double *rates) const { return {rates, parameters.size()}; }

  System &system_;
  StageMotion motion_;
  MultiplierRates multipliers_;
  StageNewton newton_;
  Projection index1_;
};

} // namespace pinconsist
