// The twin of dae/consistency.py: accelerations of the differential equation, and projections onto the constraints.
#pragma once

#include "kkt.hpp"
#include "system.hpp"

#include <limits>

namespace pinconsist {

constexpr double EPS = std::numeric_limits<double>::epsilon(), INF = std::numeric_limits<double>::infinity(),
                 NOT_A_NUMBER = std::numeric_limits<double>::quiet_NaN(), GAP = 1e-13;

template <class Derived> double largest(const Eigen::MatrixBase<Derived> &x) {
  return x.size() ? x.cwiseAbs().maxCoeff() : 0.0;
}

struct State {
  Vec p, v;
  const char *failure = ""; // "open": |Φ| = gap remains, or "singular"
  double gap = 0.0;
};

// [[M, -G], [W, 0]] at a position, factorised, and what it is good for.
class Projection {
public:
  explicit Projection(System &system)
      : system_(system), kkt_(system.nv, system.nc), rhs_(system.nv + system.nc, 1), zero_(Vec::Zero(system.nv)) {}

  System &system() const { return system_; }

  // Acceleration and multipliers of the differential equation itself; false where it is singular.
  bool acceleration(double t, const Vec &p, const Vec &v, Vec &a, Vec &lam) {
    const int nv = system_.nv, nc = system_.nc;
    system_.evaluate(t, p, v, zero_);
    rhs_.col(0).head(nv) = -system_.f;
    system_.acceleration_bias(t, p, v, bias_);
    rhs_.col(0).tail(nc) = -bias_;
    if (!solve(p, rhs_)) return false;
    a = rhs_.col(0).head(nv);
    lam = rhs_.col(0).tail(nc);
    return true;
  }

  // p and v put on the constraints, as project_position and project_velocity do.
  State project(double t, const Vec &p, const Vec &v) {
    State state{p, v};
    if (system_.nc && !position(t, state)) return state;
    for (int turn = 0; turn < 2 && system_.nc; ++turn) {
      system_.constraint(t, state.p, state.v);
      if (!shift(state.p, system_.rho)) return singular(state);
      state.v -= rhs_.col(0).head(system_.nv);
    }
    return state;
  }

  // Velocity that eps in v and in Φ brings about (dae/consistency.py).
  double velocity_rounding(double t, const Vec &p, const Vec &v) {
    const int nv = system_.nv, nc = system_.nc;
    const double size = EPS * largest(v);
    if (!nc) return size;
    system_.constraint(t, p, v);
    if (largest(system_.phi) > rounding_gap(p)) return 0.0; // more than rounding is wrong
    Mat inverse = Mat::Zero(nv + nc, nc);
    inverse.bottomRows(nc).setIdentity();
    if (!solve(p, inverse)) return INF;
    const double s = inverse.topRows(nv).cwiseAbs().rowwise().sum().maxCoeff();
    return size * (1.0 + (1.0 + largest(p)) * s * s * system_.J.cwiseAbs().rowwise().sum().maxCoeff());
  }

private:
  double rounding_gap(const Vec &p) const { return GAP * (1.0 + largest(p)) * (1.0 + largest(system_.J)); }

  bool solve(const Vec &p, Mat &rhs) {
    system_.mass_matrix(p, kkt_.A());
    return kkt_.solve_new(system_.J, 1.0, rhs, static_cast<int>(rhs.cols()));
  }

  // The smallest velocity, in the mass metric, that carries the residual; J is the one at p.
  bool shift(const Vec &p, const Vec &residual) {
    rhs_.setZero();
    rhs_.col(0).tail(system_.nc) = residual;
    return solve(p, rhs_);
  }

  bool position(double t, State &state) {
    double last = INF;
    for (int i = 0; i < 20; ++i) {
      system_.constraint(t, state.p, state.v);
      const double size = largest(system_.phi);
      if (size <= EPS || (size <= rounding_gap(state.p) && size >= 0.5 * last)) return true;
      if (!shift(state.p, system_.phi)) return singular(state), false;
      Vec moved;
      system_.integrate(state.p, -rhs_.col(0).head(system_.nv), moved);
      state.p = moved;
      last = size;
    }
    state.failure = "open";
    state.gap = last;
    return false;
  }

  static State &singular(State &state) {
    state.failure = "singular";
    return state;
  }

  System &system_;
  KKT kkt_;
  Mat rhs_;
  Vec zero_, bias_;
};

} // namespace pinconsist
