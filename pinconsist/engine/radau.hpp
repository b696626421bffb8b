// Radau IIA on the index-3 equations: the stage equations by Newton in the null space of the constraints.
//
// The unknowns of a step from (t₀, p₀, v₀) are accelerations W_i at the times t₀ + c_i h, i = 1 … s. They give
//
//     V_i = v₀ + h Σ_j a_ij W_j,    P_i = p₀ ⊕ ξ_i,    ξ_i = h Σ_j a_ij U_j
//
// with U_j the rate of ξ at stage j (V_j itself where positions are vectors), and solve, with multipliers L_i,
//
//     f(t_i, P_i, V_i, W_i) = G_i L_i,    Φ(t_i, P_i) = 0.
//
// Newton moves the stage *positions* by dP_i. The constraint then is one of each stage alone, J_i dP_i = -Φ_i, and
//
//     dP_i = Z_i y_i - N_i Φ_i,    J_i Z_i = 0,    J_i N_i = 1,
//
// leaves s (nv - nc) unknowns y. The multipliers vanish in the rows Y_iᵀ, Y_iᵀ G_i = 0 (Y_i = Z_i for rigid bodies), and
// are neither predicted nor iterated:
//
//     Y_iᵀ Σ_j (b²_ij M_i + b_ij h D_i + δ_ij h² K_i) dP_j = -h² Y_iᵀ f_i,    D = ∂f/∂v, K = ∂f/∂p,
//
// where b = A⁻¹ and b² = A⁻², as dV = A⁻¹ dP/h and dW = A⁻¹ dV/h. In a chart, U = T V, dξ = T dP, and with the bracket of
// the group δv = (δp)' + [v, δp]: dV_i = T_i⁻¹ (Σ_j b_ij T_j dP_j/h - T'_i dP_i) + [V_i, dP_i].
//
// References
// ----------
// E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, sections IV.5, IV.8, VII.4.
#pragma once

#include "newton.hpp"
#include "stage_matrix.hpp"

namespace pinconsist {

class StageNewton {
public:
  long nfev = 0, njev = 0, nlu = 0;
  // State at which a step found a value that is not finite.
  double culprit_t = 0.0;
  Vec culprit_p, culprit_v;
  Stages stages;
  double rate = 0.0; // contraction of the iteration, 0 if one was enough

  StageNewton(System &system, const Switches &switches)
      : stages(system, switches.lanes ? system.in_lanes() : nullptr), system_(system), matrix_(system, stages, switches),
        eager_(switches.iteration_forecast) {}

  // Change the number of stages.
  void use(const RadauTable &table) {
    stages.use(table);
    matrix_.use(table.s);
    contraction_ = 0.0;
    kept_h_ = 0.0;
  }

  // Discard all information about earlier steps.
  void forget() {
    matrix_.forget();
    contraction_ = 0.0;
    kept_h_ = 0.0;
  }

  // The next step begins where this one ends.
  void accepted() { matrix_.accepted(); }

  // What later steps depend on.
  auto lasting() { return std::tie(contraction_, h_before_, kept_h_, kept_rate_, kept_steps_); }
  void remember(StageMatrix::Memory &to) { matrix_.remember(to, kept_h_ != 0.0); }
  void recall(const StageMatrix::Memory &from) { matrix_.recall(from); }

  // M, ∂f/∂v and ∂f/∂p at the last stage, as in Newton's matrix.
  auto at_end() const { return matrix_.at_end(); }

  // Iterate from the accelerations W to the solution. `weight` are reciprocal tolerances of [ξ | v]. The matrix of an
  // earlier step may be used where `keeps`, if that was as long.
  Failure solve(const Vec &weight, double tol, bool keeps = false) {
    const int s = stages.size();
    const double floor = 20.0 * EPS * s * s / std::abs(stages.h);
    double last = 0.0, first = 0.0;
    rate = 0.0;
    const double longer = h_before_ != 0.0 ? std::max(1.0, std::abs(stages.h / h_before_)) : 1.0;
    contraction_ *= longer * longer; // it grows at most like h²; the start values are those of shorter steps
    h_before_ = stages.h;
    const bool same = kept_h_ != 0.0 && std::abs(stages.h - kept_h_) <= SAME_STEP * std::abs(kept_h_);
    bool kept = keeps && same && matrix_.may_be_kept() && ++kept_steps_ < static_cast<int>(KEPT);
    stages.xi.setZero();
    if (!stages.move()) return Failure::diverged;
    for (int iteration = 1; iteration <= MAX_STAGE_ITERATIONS; ++iteration) {
      bool fresh = (iteration == 1 && !kept) || rate > FRESH_RATE;
      nfev += s;
      bool regular = matrix_.evaluate(fresh, iteration > 1, njev);
      if (!regular && kept && !fresh) { // other velocities depend on the rest now
        fresh = true;
        regular = matrix_.evaluate(fresh, iteration > 1, njev);
      }
      if (!regular) return Failure::singular;
      if (fresh) {
        ++nlu;
        kept = false;
        kept_h_ = 0.0;
        if (!matrix_.factorise()) return Failure::singular;
        kept_h_ = stages.h;
        kept_steps_ = 0;
        kept_rate_ = 0.0;
      }
      matrix_.solve(dP_, dV_);
      const double size = size_of(weight);
      if (!std::isfinite(size)) return not_finite(stages.t + stages.h, stages.p, stages.v);
      if (iteration == 1) first = size;
      else rate = size / last;
      const double left = iteration == 1 ? size : to_come(size, rate);
      const double before = largest(stages.V);
      combine(dV_, stages.table->inverse, dW_, 1.0 / stages.h);
      stages.W += dW_;
      if (!stages.move()) return Failure::diverged;
      const double reach = 1.0 + largest(stages.P.col(s - 1)), step = largest(dV_);
      if (kept && iteration == 2) {
        kept_rate_ = std::max(rate, 0.3 * kept_rate_);
        if (kept_rate_ > STALE) kept_h_ = 0.0; // the next step has a new matrix
      } else if (iteration > 1 && !kept) {
        contraction_ = std::max(rate / std::sqrt(first), 0.3 * contraction_);
      }
      const double expected = kept ? kept_rate_ : contraction_ * std::sqrt(first);
      const bool eager = eager_ && iteration == 1 && expected > 0.0 && expected < 1.0 && size < EAGER &&
                         expected * size < (1.0 - expected) * tol;
      if (eager) rate = expected;
      if (std::min(size, left) <= tol || eager || step <= floor * reach) return Failure::none;
      const double noise = tolerated(rate, iteration, MAX_STAGE_ITERATIONS);
      if (noise > 0.0 && rounded(before, noise, per_position(stages.h / (s * s), tol))) return Failure::none;
      if (iteration > 2 && rate > 2.0) return Failure::diverged;
      last = size;
    }
    return Failure::not_converged;
  }

  // Record the state at which a value is not finite.
  Failure not_finite(double t, const Vec &p, const Vec &v) {
    culprit_t = t;
    culprit_p = p;
    culprit_v = v;
    return Failure::not_finite;
  }

private:
  static constexpr double EAGER = 30.0; // of the tolerance: a larger first increment is never the last
  static constexpr double STALE = 0.1; // contraction with a matrix that is not worth keeping
  static constexpr double SAME_STEP = 1e-9; // relative difference of steps as long as each other

  // Whether the increments are only rounding errors, beside the largest velocity before them.
  bool rounded(double before, double noise, double per_position) {
    const Vec &p = stages.P.rightCols(1);
    matrix_.free_velocities(dP_, dV_);
    const bool closed = matrix_.gap <= rounding_gap(p, system_.G_transposed());
    const double scale = before + largest(stages.v), moved = largest(matrix_.closing());
    return is_noise(largest(dV_), moved, scale, 1.0 + largest(p), noise, per_position, closed);
  }

  // Root mean square over the stages of the weighted increments.
  double size_of(const Vec &weight) const {
    const int nx = system_.nx, nv = system_.nv;
    double sum = 0.0;
    const double most = nx == nv || !nx ? 0.0 : weight.head(nx).maxCoeff();
    for (int i = 0; i < stages.size(); ++i) {
      sum += dV_.col(i).cwiseProduct(weight.tail(nv)).squaredNorm();
      sum += nx == nv ? dP_.col(i).cwiseProduct(weight.head(nx)).squaredNorm() : most * most * dP_.col(i).squaredNorm();
    }
    return std::sqrt(sum / std::max(1, stages.size() * nv));
  }

  System &system_;
  StageMatrix matrix_;
  bool eager_;
  // Contraction in the last steps, over the root of the first increment: the matrix is that of the state before it.
  double contraction_ = 0.0;
  double h_before_ = 0.0; // the step tried before, 0 if there is none
  // The step of the matrix, 0 if it is not to be kept; steps since then; contraction with it, 0 if it is not known.
  double kept_h_ = 0.0, kept_rate_ = 0.0;
  int kept_steps_ = 0;
  Mat dP_, dV_, dW_;
};

} // namespace pinconsist
