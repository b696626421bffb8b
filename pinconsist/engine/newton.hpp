// Scaled Newton iteration on the KKT block matrix: from a predictor to the solution of one step of BDF.
//
// Unknowns are v and λ; the position follows from v by p = base ⊕ (ψ_ξ + c U). The residuals
//
//     r₁ = c (f(t, p, v, (v - ψ_v)/c) - G λ),        r₂ = Φ(t, p)
//
// belong, the second divided by c, to the matrix
//
//     K = [ A  -c G ]      A = M + c ∂f/∂v + c² ∂f/∂p
//         [ W    0  ]
//
// whose condition, once its last columns are scaled, does not depend on the step size (the raw index-3 matrix grows like
// h⁻³). One factorisation serves the right-hand sides (r₁, 0) for the dynamics, and (0, r₂) for the constraint, whose
// rounding noise eps/c is judged only by the change of position that it causes. Then every step is corrected, see
// engine/consistency.py. Forecasts and kept matrices save evaluations.
#pragma once

#include "bdf.hpp"
#include "forecast.hpp"
#include "rounding.hpp"

namespace pinconsist {

// Why there is no step; the messages are in failure.py, under these names.
enum class Failure { none, singular, not_finite, diverged, not_converged, error_test, turns_too_far, singular_between, constraint_jumps };

inline const char *name_of(Failure failure) {
  static constexpr const char *names[] = {"",           "singular",   "not_finite",   "diverged", "not_converged",
                                          "error_test", "turns_too_far", "singular_between", "constraint_jumps"};
  return names[static_cast<int>(failure)];
}

struct Attempt {
  Vec y, p, change;
  double size = 0.0; // of the change, weighted
  Failure failure = Failure::none;
};

template <class Difference> double weighted_norm(const Difference &change, const Vec &weight, int nv) {
  return std::sqrt(change.head(weight.size()).cwiseProduct(weight).squaredNorm() / nv);
}

class Newton {
public:
  long nfev = 0, njev = 0, nlu = 0;
  // Where an attempt found a value that is not finite.
  double culprit_t = 0.0;
  Vec culprit_p, culprit_v;
  const bool corrects; // every step, onto the constraints

  Newton(System &system, bool correct, const Switches &switches)
      : corrects(correct), system_(system), kkt_(system.nv, system.nc), forecast_(switches.iteration_forecast),
        reuse_(system.nv, switches.jacobian_reuse),
        derivatives_(switches.kept_derivatives && system.keeps_derivatives && system.nv < WORTH),
        rhs_(Mat::Zero(system.nv + system.nc, 2)), closing_(Mat::Zero(system.nv + system.nc, 2)) {}

  void forget() {
    forecast_.forget();
    reuse_.forget();
    derivatives_.forget();
  }

  void attempt(double t, const Vec &base, const Vec &psi, const Vec &predicted, double c, const Vec &weight, double tol,
               Attempt &step) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc;
    psi_x_ = psi.head(nx);
    x_ = predicted.tail(nv + nc);
    v_ = x_.head(nv);
    double last = 0.0, rate = 0.0;
    bool slow = false;
    a_ = (v_ - psi.segment(nx, nv)) / c;
    system_.position(t, base, psi_x_, c, v_, step.p, xi_);
    bool stale = reuse_.pays(c);
    for (int iteration = 1; iteration <= MAX_ITERATIONS; ++iteration) {
      system_.evaluate(t, step.p, v_, a_);
      rhs_.setZero();
      force_.noalias() = system_.G_transposed().transpose() * x_.tail(nc);
      system_.f -= force_;
      rhs_.col(0).head(nv) = c * system_.f;
      rhs_.col(1).tail(nc) = system_.phi;
      ++nfev;
      stale = stale && !constraints_changed();
      const bool was_stale = stale;
      if (slow || !(stale || iteration > 1)) {
        const bool fresh = !derivatives_.possible() || derivatives_.fresh(slow);
        system_.linearize(t, step.p, v_, a_, x_.tail(nc), c, kkt_.A(), fresh);
        if (slow && !stale) // the rotation of the constraint forces, neglected at first, slows Newton down
          system_.subtract_force_gradient(t, step.p, v_, x_.tail(nc), c, kkt_.A());
        stale = false;
        reuse_.made(c);
        ++njev;
        ++nlu;
        if (!kkt_.solve_new(system_.W, system_.G_transposed(), c, rhs_)) return fail(step, predicted, Failure::singular);
        if (reuse_.possible() && nc) measure_constraints(c);
      } else {
        kkt_.solve(rhs_, c);
      }
      reuse_.iterated();
      move_ = rhs_.col(0) + rhs_.col(1) / c;
      raw_ = v_ - move_.head(nv);
      system_.position(t, base, psi_x_, c, raw_, step.p, xi_);
      step.y.resize(predicted.size());
      step.y << xi_, x_ - move_;
      if (iteration == 1) {
        step.change = step.y - predicted;
        step.size = weighted_norm(step.change, weight, nv);
        if (corrects && !stale && forecast_.one_is_enough(step.size, c, tol)) {
          close(t, base, c, weight, predicted, step, MEASURED);
          step.failure = Failure::none;
          return;
        }
      }
      const double size =
          std::sqrt((rhs_.col(0).head(nv).cwiseProduct(weight.tail(nv)).squaredNorm() + moved_size(weight)) / nv);
      if (iteration > 1) rate = size / last;
      if (!std::isfinite(size)) {
        culprit_t = t;
        culprit_p = base;
        culprit_v = v_;
        return fail(step, predicted, Failure::not_finite);
      }
      if (iteration == 2 && !stale) forecast_.measured(rate, c);
      if (iteration == 2) derivatives_.not_enough();
      const double left = iteration == 1 ? size : to_come(size, rate);
      const bool settled = std::min(size, left) <= (stale ? STALE_FACTOR * tol : tol);
      const double noise = tolerated(rate, iteration, MAX_ITERATIONS);
      if (settled || (noise > 0.0 && !stale && rounded(step.p, largest(psi.segment(nx, nv)), noise, per_position(c, tol)))) {
        step.change = step.y - predicted;
        step.size = weighted_norm(step.change, weight, nv);
        if (corrects) close(t, base, c, weight, predicted, step, iteration > 1 ? rate : 1.0);
        step.failure = Failure::none;
        return;
      }
      if (rate > 2.0 && iteration > 2 && !was_stale) return fail(step, predicted, Failure::diverged);
      slow = rate > FRESH_RATE || size * std::pow(rate, MAX_ITERATIONS - iteration) > tol;
      last = size;
      x_ -= move_;
      v_ = x_.head(nv);
      a_ = (v_ - psi.segment(nx, nv)) / c;
    }
    fail(step, predicted, Failure::not_converged);
  }

private:
  static constexpr double MEASURED = -1.0;

  static void fail(Attempt &step, const Vec &predicted, Failure failure) {
    step.y = predicted;
    step.failure = failure;
  }

  // Close the loops at the new position and remove ρ; the dynamics are not evaluated again. `rate` is the fraction of a
  // gap that remains after a correction: after several iterations their contraction, after one it is MEASURED. A gap is
  // half of the change of the Jacobian along the displacement, times the displacement.
  void close(double t, const Vec &base, double c, const Vec &weight, const Vec &predicted, Attempt &step, double rate) {
    const int nx = system_.nx, nv = system_.nv, nc = system_.nc;
    for (int turn = 0; turn < CLOSINGS; ++turn) {
      v_ = step.y.segment(nx, nv);
      system_.constraint(t, step.p, v_);
      closing_.setZero();
      closing_.col(0).tail(nc) = system_.phi;
      closing_.col(1).tail(nc) = system_.rho;
      kkt_.solve(closing_, c);
      reuse_.iterated();
      const double gap = largest(system_.phi) / (1.0 + largest(step.p));
      if (rate == MEASURED) {
        const double moved = largest(step.change.head(nx));
        rate = moved != 0.0 ? std::min(1.0, 2.0 * gap / moved) : 0.0;
      }
      raw_ -= closing_.col(0).head(nv) / c;
      system_.position(t, base, psi_x_, c, raw_, step.p, xi_);
      step.y.head(nx) = xi_;
      step.y.tail(nv + nc) -= closing_.col(1);
      if (gap * rate <= GAP_LEFT) break;
    }
    step.change = step.y - predicted;
    step.size = weighted_norm(step.change, weight, nv);
  }

  // Stores the constraints of the kept matrix: Gᵀ, its row lengths, and its smallest singular value with rows of unit
  // length, by one step of inverse iteration.
  void measure_constraints(double c) {
    const int nv = system_.nv, nc = system_.nc;
    kept_ = system_.G_transposed();
    lengths_ = kept_.rowwise().norm().cwiseMax(EPS);
    if (!weakest_.size()) weakest_ = Vec::LinSpaced(nv + nc, 1.0, nv + nc).array().sin().matrix();
    weakest_.topRows(nv).setZero();
    kkt_.solve(weakest_, c);
    weakest_ /= weakest_.bottomRows(nc).cwiseProduct(lengths_).norm();
    force_.noalias() = kept_.transpose() * weakest_.bottomRows(nc);
    least_ = force_.norm();
  }

  // Whether the constraints have changed so much since then that Newton would be slow, or diverge, in some direction,
  // which near singular positions its increments do not show.
  bool constraints_changed() {
    if (!system_.nc) return false;
    return ((system_.G_transposed() - kept_).rowwise().norm().cwiseQuotient(lengths_)).norm() > FRESH_RATE * least_;
  }

  // Σ (weight · increment)² of the positions that the correction of the constraint moves.
  double moved_size(const Vec &weight) const {
    const int nx = system_.nx, nv = system_.nv;
    const auto moved = rhs_.col(1).head(nv);
    if (nx == nv) return moved.cwiseProduct(weight.head(nv)).squaredNorm();
    const double most = nx ? weight.head(nx).maxCoeff() : 0.0;
    return most * most * moved.squaredNorm();
  }

  // Whether Newton's increments are only rounding errors.
  bool rounded(const Vec &p, double psi_v, double noise, double per_position) const {
    const double step = largest(rhs_.col(0).head(system_.nv)), moved = largest(rhs_.col(1).head(system_.nv));
    const bool closed = largest(system_.phi) <= rounding_gap(p, system_.G_transposed());
    return is_noise(step, moved, largest(v_) + psi_v, 1.0 + largest(p), noise, per_position, closed);
  }

  System &system_;
  KKT kkt_;
  Forecast forecast_;
  JacobianReuse reuse_;
  KeptDerivatives derivatives_;
  double least_ = 0.0;
  Mat rhs_, closing_, kept_, weakest_;
  Vec psi_x_, x_, v_, a_, xi_, raw_, move_, force_, lengths_;
};

} // namespace pinconsist
