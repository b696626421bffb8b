// Steps of Radau IIA repeated, and derivatives propagated along them, forwards and backwards.
#pragma once

#include "radau.hpp"
#include "stage_gradient.hpp"

namespace pinconsist {

// The derivatives of λ at a state by those of the state.
class MultiplierRates {
public:
  Vec lam;

  MultiplierRates(System &system, const Parameters &parameters)
      : parameters_(parameters), system_(system), rows_(system), index1_(system), at_(system) {}

  bool set(double t, const Vec &p, const Vec &v) {
    Mat F;
    if (!index1_.acceleration(t, p, v, a_, lam) || !at_.set(t, p, v, a_)) return false;
    K_ = at_.K;
    rows_.find_second(t, p, v, a_, lam, F, by_p_, by_v_);
    K_ -= F;
    t_ = t;
    p_ = p;
    v_ = v;
    return true;
  }

  void forward(const Mat &s, Mat &of_lam) {
    const int nv = system_.nv, nc = system_.nc;
    Mat rhs = Mat::Zero(nv + nc, s.cols());
    parameters_.add_columns(t_, p_, v_, a_, [this](System &other) { return residuals(other); }, rhs);
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
    parameters_.contract(t_, p_, v_, a_, [this](System &other) { return residuals(other); }, weights, rates);
  }

private:
  // (r, β)
  Vec residuals(System &other) const {
    Vec all(other.nv + other.nc);
    all << other.f - other.G_transposed().transpose() * lam, beta(other, t_, p_, v_, a_);
    return all;
  }

  const Parameters &parameters_;
  System &system_;
  RowGradients rows_;
  Projection index1_;
  StatePoint at_;
  double t_ = 0.0;
  Vec p_, v_, a_;
  Mat K_, by_p_, by_v_;
};

// Each method returns the index of the singular step or state, or -1.
class Derivatives {
public:
  Parameters parameters;

  explicit Derivatives(System &system)
      : system_(system), motion_(system, parameters), multipliers_(system, parameters), newton_(system, Switches{}), index1_(system) {}

  // Solve the steps to rounding from their accelerations; updates these and the ends of the steps.
  int again(StageSteps &steps) {
    const int nx = system_.nx, nv = system_.nv;
    Vec weight, y = Vec::Zero(nx + nv);
    double *W = steps.W.data();
    for (int i = 0; i < steps.size(); ++i) {
      const RadauTable &table = RadauTable::of.at(static_cast<int>(steps.s[i]));
      Stages &stages = newton_.stages;
      newton_.use(table);
      newton_.forget();
      steps.place(i, W, stages);
      if (system_.vector_like) y.head(nx) = stages.p;
      y.tail(nv) = stages.v;
      const double tol = rounding_weights(system_, y, weight);
      if (newton_.solve(weight, tol) != Failure::none) return i;
      const State end = index1_.project(steps.t[i], stages.P.col(table.s - 1), stages.V.col(table.s - 1));
      if (*end.failure) return i;
      Eigen::Map<Mat>(W, nv, table.s) = stages.W;
      steps.p.row(i) = end.p.transpose();
      steps.v.row(i) = end.v.transpose();
      W += nv * table.s;
    }
    return -1;
  }

  // Rows (P, nx+nv) of `ends` from those of `starts`, which may be the same table shifted by one row.
  int forward(const StageSteps &steps, Eigen::Map<const Table> starts, Eigen::Map<Table> ends) {
    const int n = 2 * system_.nv, P = parameters.size();
    const double *W = steps.W.data();
    for (int i = 0; i < steps.size(); ++i) {
      if (!motion_.set(steps, i, W)) return i;
      W += system_.nv * steps.s[i];
      motion_.forward(Eigen::Map<const Mat>(starts.row(i).data(), n, P), Eigen::Map<Mat>(ends.row(i).data(), n, P));
    }
    return -1;
  }

  // The transpose, from the last step to the first: adds to rows (nx+nv) of `bars`, and to `rates`, (P).
  int backward(const StageSteps &steps, Eigen::Map<const Table> given, Eigen::Map<Table> bars, Eigen::Map<Vec> rates) {
    const double *W = steps.W.data() + steps.W.size();
    Vec start;
    for (int i = steps.size(); i-- > 0;) {
      W -= system_.nv * steps.s[i];
      if (!motion_.set(steps, i, W)) return i;
      motion_.backward(given.row(i).transpose(), start, rates);
      bars.row(i) += start.transpose();
    }
    return -1;
  }

  // λ at states (t, p, v), and its derivatives (P, nc) from those of the states.
  int multipliers(const Vec &t, const Table &p, const Table &v, Eigen::Map<const Table> s, Eigen::Map<Table> lam, Eigen::Map<Table> of_lam) {
    const int nv = system_.nv, P = parameters.size();
    Mat found;
    for (int i = 0; i < t.size(); ++i) {
      if (!multipliers_.set(t[i], p.row(i), v.row(i))) return i;
      multipliers_.forward(Eigen::Map<const Mat>(s.row(i).data(), 2 * nv, P), found);
      Eigen::Map<Mat>(of_lam.row(i).data(), system_.nc, P) = found;
      lam.row(i) = multipliers_.lam.transpose();
    }
    return -1;
  }

  // The transpose: adds to `bars`, (n, nx+nv), and `rates`, (P).
  int multipliers_back(const Vec &t, const Table &p, const Table &v, const Table &lam, Eigen::Map<Table> bars, Eigen::Map<Vec> rates) {
    Vec bar;
    for (int i = 0; i < t.size(); ++i) {
      if (!multipliers_.set(t[i], p.row(i), v.row(i))) return i;
      multipliers_.backward(lam.row(i), bar, rates);
      bars.row(i) += bar.transpose();
    }
    return -1;
  }

  bool calls_python() const { return system_.calls_python() || parameters.calls_python(); }

private:
  System &system_;
  StageMotion motion_;
  MultiplierRates multipliers_;
  StageNewton newton_;
  Projection index1_;
};

} // namespace pinconsist
