// The stages of one step of Radau IIA, a column for each.
#pragma once

#include "charts.hpp"
#include "null_space.hpp"

#include <map>

namespace pinconsist {

// The table of engine/radau_table.py for the formula with s stages.
struct RadauTable {
  int s = 0;
  Vec c;
  Mat A, inverse, inverse2, modes; // modes: to the coefficients of Legendre polynomials
  Mat raised;                      // the same with a value at the start
  Vec between, weights;            // Gauss's formula with s + 1 points
  Mat reach;                       // integrals of the stages' polynomials up to these points
  Mat eigenvalues;                 // of A⁻¹, (2, m): real and imaginary parts of the real ones, and of one of each pair
  Mat eigenvectors;                // (s, 2 m): real and imaginary parts, column by column
  Mat to_eigenvectors;             // (2 m, s): of the inverse of all eigenvectors, row by row
  Vec at_start;                    // weights of the stages for the value of their polynomial at the start
  // How much rounding of stage positions affects the highest coefficient, and this value, times h².
  double leading = 0.0, starting = 0.0;

  double between_stages() const { return 0.5 * (c[s / 2 - 1] + c[s / 2]); } // not near the middle, where modes vanish

  static inline std::map<int, RadauTable> of; // by s
};

class Stages {
public:
  // Start and size of the step; accelerations, velocities, positions P = p ⊕ ξ.
  const RadauTable *table = nullptr;
  double t = 0.0, h = 0.0;
  Vec p, v;
  Mat W, V, xi, P;

  explicit Stages(const System &system, const lanes::Tree *tree = nullptr) : system_(system), tree_(tree) {}

  void use(const RadauTable &formula) {
    table = &formula;
    W.setZero(system_.nv, formula.s);
    xi.setZero(system_.nx, formula.s);
    P.resize(system_.npos, formula.s);
    U_.resize(system_.nx, formula.s);
  }

  int size() const { return table->s; }
  double time(int i) const { return t + h * table->c[i]; }
  // Rates of ξ.
  const Mat &U() const { return plain() ? V : U_; }

  // Velocities and positions from the accelerations W; rates that depend on positions by fixed-point iteration.
  bool move() {
    combine(W, table->A, V, h);
    for (int i = 0; i < size(); ++i) V.col(i) += v;
    if (plain()) {
      combine(V, table->A, xi, h);
      place();
      return P.allFinite();
    }
    double moved = INF;
    for (int sweep = 0; sweep < MAX_SWEEPS && moved > 4.0 * EPS; ++sweep) {
      if (!system_.rate_is_velocity) place(); // otherwise rates do not depend on positions
      if (tree_)
        lanes::kernel().chart_rates(*tree_, size(), xi.data(), V.data(), bernoulli().data(), static_cast<int>(bernoulli().size()), U_.data());
      for (int i = 0; i < size() && !tree_; ++i) {
        p_ = P.col(i);
        v_ = V.col(i);
        xi_ = xi.col(i);
        system_.chart_rate(xi_, system_.rate(time(i), p_, v_), rate_);
        U_.col(i) = rate_;
      }
      before_ = xi;
      combine(U_, table->A, xi, h);
      moved = largest(xi - before_) / (1.0 + largest(xi));
    }
    place();
    return moved < std::sqrt(EPS) && P.allFinite();
  }

private:
  bool plain() const { return system_.rate_is_velocity && system_.curved.empty(); }

  void place() {
    if (system_.vector_like) {
      for (int i = 0; i < size(); ++i) P.col(i) = xi.col(i) + p;
      return;
    }
    for (int i = 0; i < table->s; ++i) {
      xi_ = xi.col(i);
      system_.integrate(p, xi_, p_);
      P.col(i) = p_;
    }
  }

  const System &system_;
  const lanes::Tree *tree_; // of joints whose rates are found in all stages at once; or null
  Mat U_, before_;
  Vec p_, v_, xi_, rate_;
};

} // namespace pinconsist
