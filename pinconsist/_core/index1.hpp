// dae/index1.py: accelerations, projections onto the constraints, and DOP853 with the coefficients of SciPy.
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

  // Project p and v onto the constraints, as project_position and project_velocity do.
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
    system_.constraint(t, p, v);
    if (!shift(t, p, v, system_.phi)) return false;
    move(t, p, v);
    system_.constraint(t, p, v);
    shift(t, p, v, system_.rho, true);
    v -= rhs_.col(0).head(nv);
    negative_forces(t, p, v, true);
    kkt_.solve(rhs_, 1.0, 1);
    lam = rhs_.col(0).tail(nc);
    return true;
  }

private:
  bool solve_acceleration(double t, const Vec &p, const Vec &v, Vec &a, Vec &lam, bool evaluated, const KKT *known = nullptr) {
    negative_forces(t, p, v, evaluated);
    if (known) known->solve(rhs_, 1.0, 1);
    else if (!solve(t, p, v)) return false;
    a = rhs_.col(0).head(system_.nv);
    lam = rhs_.col(0).tail(system_.nc);
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
    return kkt_.solve_new(system_.W, system_.G_transposed(), 1.0, rhs_, 1);
  }

  // The smallest velocity, in the mass metric, that has this residual; W is evaluated at p or, if `factored`, is the last
  // factorised one, from very near p.
  bool shift(double t, const Vec &p, const Vec &v, const Vec &residual, bool factored = false) {
    rhs_.setZero();
    rhs_.col(0).tail(system_.nc) = residual;
    if (!factored) return solve(t, p, v);
    kkt_.solve(rhs_, 1.0, 0);
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

class OneStep {
public:
  // Hairer's coefficients: for the stages, the two error estimates, and the stages and the matrix of the interpolant.
  struct Coefficients {
    Table A, A_extra, D;
    Vec B, C, E3, E5, C_extra;
  };
  static inline Coefficients method;

  double t, step_size = 0.0;
  bool finished = false;
  long evaluations = 0;
  Vec y;
  // Where an evaluation was singular or not finite since the last successful one; empty without such an evaluation.
  double culprit_t = 0.0;
  Vec culprit_p, culprit_v;

  OneStep(Projection &projection, const Vec &base, double t0, const Vec &y0, double t_end, double rtol,
          double atol, double max_step, bool dense)
      : t(t0), y(y0), system_(projection.system()), projection_(projection), base_(base), t_end_(t_end), rtol_(rtol), atol_(atol),
        max_step_(max_step), direction_(t_end >= t0 ? 1.0 : -1.0), dense_(dense),
        K_(method.A.rows() + 1 + method.A_extra.rows(), y.size()) {
    evaluate(t, y, f_);
    size_ = initial_step();
  }

  // Make one step; returns why it failed, or an empty string.
  const char *step() {
    const double smallest = 10.0 * std::abs(std::nextafter(t, direction_ * INF) - t);
    const int stages = static_cast<int>(method.B.size());
    double size = size_ > max_step_ ? max_step_ : std::max(size_, smallest), h, t_new;
    bool rejected = false;
    Vec y_new, f_new;
    while (true) {
      if (singular_ && !started_) return "singular";
      if (!(size >= smallest)) // nor is it a number
        return singular_ ? "singular" : "Required step size is less than spacing between numbers.";
      t_new = t + size * direction_;
      if (direction_ * (t_new - t_end_) > 0.0) t_new = t_end_;
      h = t_new - t;
      size = std::abs(h);
      K_.row(0) = f_.transpose();
      for (int s = 1; s < stages; ++s) stage(s, method.A.row(s), method.C[s], h);
      y_new = y + h * (K_.topRows(stages).transpose() * method.B);
      evaluate(t_new, y_new, f_new);
      K_.row(stages) = f_new.transpose();
      const double error = error_norm(y_new, h);
      if (error < 1.0) {
        const double factor = error == 0.0 ? MOST : std::min(MOST, CAREFUL * std::pow(error, EXPONENT));
        size *= rejected ? std::min(1.0, factor) : factor;
        break;
      }
      size *= std::max(LEAST, CAREFUL * std::pow(error, EXPONENT)); // LEAST if the error is not a number
      rejected = true;
    }
    if (dense_) interpolate(y_new, f_new, t_new, h);
    if (singular_) return "singular";
    std::swap(y, y_new);
    std::swap(f_, f_new);
    t = t_new;
    step_size = std::abs(h);
    size_ = size;
    finished = direction_ * (t - t_end_) >= 0.0;
    return "";
  }

  // [ξ | v] at times inside the steps made, one per row.
  Table sample(const Vec &times) const {
    Table rows(times.size(), y.size());
    for (Eigen::Index i = 0; i < times.size(); ++i) {
      size_t piece = 0;
      while (piece + 1 < pieces_.size() && direction_ * pieces_[piece].t < direction_ * times[i]) ++piece;
      rows.row(i) = pieces_[piece].at(times[i]);
    }
    return rows;
  }

private:
  static constexpr double LEAST = 0.2, MOST = 10.0, CAREFUL = 0.9, EXPONENT = -1.0 / 8.0;

  struct Piece {
    double t_old, t;
    Vec y_old;
    Table F;

    Eigen::RowVectorXd at(double time) const {
      const double x = (time - t_old) / (t - t_old);
      Eigen::RowVectorXd value = Eigen::RowVectorXd::Zero(F.cols());
      for (Eigen::Index i = F.rows(); i-- > 0;) value = (value + F.row(i)) * ((F.rows() - 1 - i) % 2 ? 1.0 - x : x);
      return value + y_old.transpose();
    }
  };

  // f(t, [ξ | v]); NaN if the equations are not finite: a shorter step then follows.
  void evaluate(double time, const Vec &state, Vec &f) {
    const int nx = system_.nx, nv = system_.nv;
    ++evaluations;
    v_ = state.tail(nv);
    if (system_.vector_like) p_ = state.head(nx);
    else system_.integrate(base_, state.head(nx), p_);
    const bool regular = projection_.acceleration(time, p_, v_, a_, lam_);
    if (!regular || !a_.allFinite() || !lam_.allFinite()) {
      if (state.allFinite()) { // if not, an earlier stage failed
        culprit_t = time, culprit_p = p_, culprit_v = v_;
        singular_ = !regular;
      }
      f.setConstant(state.size(), NOT_A_NUMBER);
      return;
    }
    culprit_p.resize(0);
    singular_ = false;
    started_ = true;
    f.resize(state.size());
    system_.chart_rate(state.head(nx), v_, rate_);
    f.head(nx) = rate_;
    f.tail(nv) = a_;
  }

  template <class Row> void stage(int s, const Row &a, double c, double h) {
    const Vec moved = y + h * (K_.topRows(s).transpose() * a.head(s).transpose());
    evaluate(t + c * h, moved, k_);
    K_.row(s) = k_.transpose();
  }

  double error_norm(const Vec &y_new, double h) const {
    const auto stages = K_.topRows(method.E5.size());
    const Vec scale = (y.cwiseAbs().cwiseMax(y_new.cwiseAbs()) * rtol_).array() + atol_;
    const double fifth = (stages.transpose() * method.E5).cwiseQuotient(scale).squaredNorm();
    const double third = (stages.transpose() * method.E3).cwiseQuotient(scale).squaredNorm();
    if (fifth == 0.0 && third == 0.0) return 0.0;
    return std::abs(h) * fifth / std::sqrt((fifth + 0.01 * third) * static_cast<double>(scale.size()));
  }

  double initial_step() {
    const double interval = std::abs(t_end_ - t);
    const Vec scale = (y.cwiseAbs() * rtol_).array() + atol_;
    const auto norm = [&](const Vec &x) { return x.cwiseQuotient(scale).norm() / std::sqrt(double(x.size())); };
    const double d0 = norm(y), d1 = norm(f_), h0 = std::min(d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1, interval);
    Vec f1;
    evaluate(t + h0 * direction_, y + h0 * direction_ * f_, f1);
    const double d2 = norm(f1 - f_) / h0;
    const double h1 = d1 <= 1e-15 && d2 <= 1e-15 ? std::max(1e-6, 1e-3 * h0) : std::pow(0.01 / std::max(d1, d2), -EXPONENT);
    return std::min({100.0 * h0, h1, interval, max_step_});
  }

  void interpolate(const Vec &y_new, const Vec &f_new, double t_new, double h) {
    const int stages = static_cast<int>(method.B.size()) + 1, extra = static_cast<int>(method.C_extra.size());
    for (int i = 0; i < extra; ++i) stage(stages + i, method.A_extra.row(i), method.C_extra[i], h);
    const Vec moved = y_new - y;
    Table F(3 + method.D.rows(), y.size());
    F.row(0) = moved.transpose();
    F.row(1) = (h * f_ - moved).transpose();
    F.row(2) = (2.0 * moved - h * (f_new + f_)).transpose();
    F.bottomRows(method.D.rows()) = h * method.D * K_;
    pieces_.push_back({t, t_new, y, F});
  }

  System &system_;
  Projection &projection_;
  const Vec base_;
  const double t_end_, rtol_, atol_, max_step_, direction_;
  const bool dense_;
  bool singular_ = false, started_ = false;
  double size_;
  Table K_;
  Vec f_, k_, p_, v_, a_, lam_, rate_;
  std::vector<Piece> pieces_;
};

} // namespace pinconsist
