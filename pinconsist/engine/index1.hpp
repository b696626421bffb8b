// engine/index1.py: accelerations, and projections onto the constraints.
#pragma once

#include "kkt.hpp"
#include "rounding.hpp"

namespace pinconsist {

struct State {
  Vec p, v;
  const char *failure = ""; // "open": |Φ| = gap remains, or "singular"
  double gap = 0.0;
};

// [[M, -G], [W, 0]] at a position, factorised.
class Projection {
public:
  explicit Projection(System &system)
      : system_(system), kkt_(system.nv, system.nc), rhs_(system.nv + system.nc, 1) {}

  System &system() const { return system_; }

  // Acceleration and multipliers of the differential equation itself; false if it is singular.
  bool acceleration(double t, const Vec &p, const Vec &v, Vec &a, Vec &lam) {
    return solve_acceleration(t, p, v, a, lam, false);
  }

  // The same at the position at which the constraint was evaluated last, with the matrix `known` if it is not null.
  bool acceleration_after_constraint(double t, const Vec &p, const Vec &v, Vec &a, Vec &lam, const KKT *known) {
    return solve_acceleration(t, p, v, a, lam, true, known);
  }

  // The smallest velocity, in the metric of M, with the residual `rho` of the hidden constraint; false if singular.
  bool velocity_shift(double t, const Vec &p, const Vec &v, const Vec &rho, Vec &found) {
    system_.constraint(t, p, v);
    if (!shift(t, p, v, rho)) return false;
    found = rhs_.col(0).head(system_.nv);
    return true;
  }

  // Project p and v onto the constraints.
  State project(double t, const Vec &p, const Vec &v) {
    State state{p, v};
    if (system_.nc && !position(t, state)) return state;
    for (int turn = 0; turn < 2 && system_.nc; ++turn) {
      system_.constraint(t, state.p, state.v);
      if (!shift(t, state.p, state.v, system_.rho, turn == 1)) return singular(state);
      state.v -= rhs_.col(0).head(system_.nv);
    }
    return state;
  }

  // Project p and v, which nearly satisfy both constraints, onto them, and compute λ with the same factors; false if these
  // are singular.
  bool settle(double t, Vec &p, Vec &v, Vec &lam) {
    const int nv = system_.nv, nc = system_.nc;
    lam.resize(nc);
    if (!nc) return true;
    if (system_.reacts() && !solve_acceleration(t, p, v, shift_, lam, false)) return false; // G is that of these multipliers
    system_.constraint(t, p, v);
    if (!shift(t, p, v, system_.phi)) return false;
    move(t, p, v);
    system_.constraint(t, p, v);
    shift(t, p, v, system_.rho, true);
    v -= rhs_.col(0).head(nv);
    if (system_.reacts()) return solve_acceleration(t, p, v, shift_, lam, true);
    negative_forces(t, p, v, true);
    kkt_.solve(rhs_, 1.0);
    lam = rhs_.col(0).tail(nc);
    return true;
  }

private:
  bool solve_acceleration(double t, const Vec &p, const Vec &v, Vec &a, Vec &lam, bool evaluated, const KKT *known = nullptr) {
    negative_forces(t, p, v, evaluated);
    if (system_.reacts()) {
      if (!solve_with_reactions(t, p, v)) return false;
    } else if (known) known->solve(rhs_, 1.0);
    else if (!solve(t, p, v)) return false;
    a = rhs_.col(0).head(system_.nv);
    lam = rhs_.col(0).tail(system_.nc);
    return true;
  }

  // Where G depends on the multipliers.
  bool solve_with_reactions(double t, const Vec &p, const Vec &v) {
    const Mat given = rhs_;
    for (int turn = 0; turn < REACTIONS; ++turn) {
      rhs_ = given;
      if (!solve(t, p, v)) return false;
      if (!system_.react(rhs_.col(0).tail(system_.nc), v)) break;
    }
    return true;
  }

  // The right-hand side for the accelerations.
  void negative_forces(double t, const Vec &p, const Vec &v, bool evaluated) {
    system_.evaluate_bias(t, p, v, evaluated, bias_);
    rhs_.col(0).head(system_.nv) = -system_.f;
    rhs_.col(0).tail(system_.nc) = -bias_;
  }

  bool solve(double t, const Vec &p, const Vec &v) {
    system_.mass_matrix(t, p, v, kkt_.A());
    return kkt_.solve_new(system_.W, system_.G_transposed(), 1.0, rhs_);
  }

  // The smallest velocity, in the mass metric, that has this residual; W is evaluated at p or, if `factored`, is the last
  // factorised one, from very near p.
  bool shift(double t, const Vec &p, const Vec &v, const Vec &residual, bool factored = false) {
    rhs_.setZero();
    rhs_.col(0).tail(system_.nc) = residual;
    if (!factored) return solve(t, p, v);
    kkt_.solve(rhs_, 1.0);
    return true;
  }

  // Move p back by the velocities that `shift` found.
  void move(double t, Vec &p, const Vec &v) {
    shift_ = rhs_.col(0).head(system_.nv);
    if (!system_.rate_is_velocity) shift_ = system_.moved_by(t, p, v, shift_);
    shift_ *= -1.0;
    system_.integrate(p, shift_, moved_);
    std::swap(p, moved_);
  }

  bool position(double t, State &state) {
    double last = INF;
    for (int i = 0; i < 20; ++i) {
      system_.constraint(t, state.p, state.v);
      const double size = largest(system_.phi);
      if (size <= EPS || (size <= rounding_gap(state.p, system_.W) && size >= 0.5 * last)) return true;
      if (!shift(t, state.p, state.v, system_.phi)) return singular(state), false;
      move(t, state.p, state.v);
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
  Vec bias_, shift_, moved_;
};

} // namespace pinconsist
