// The linearised equations of one step of Radau IIA, and of the multipliers at a state.
//
// A step from (p₀, v₀) has stages (P_i, V_i, W_i) with multipliers L_i, see radau.hpp. With
// the derivatives s_p, s_v of its start by θ, and dξ_i = T_i (dP_i - Ad_i s_p), Ad_i = 1 - T_i⁻¹ ad ξ_i,
//
//     dV_i = T_i⁻¹ (Σ_j b_ij dξ_j/h - N_i dξ_i),   N_i = ∂(T_i V_i)/∂ξ_i,      dW_i = Σ_j b_ij (dV_j - s_v)/h,
//     M_i dW_i + D_i dV_i + (K_i - F_i) dP_i + r_θi = G_i dL_i,    J_i dP_i + Φ_θi = 0,    r = f - G L,  F = ∂(G L)/∂ξ.
//
// As in the run, dP_i = Z_i y_i - N_i Φ_θi, and Zᵀ G = 0 leaves s (nv - nc) unknowns y. Here T and N are exact, because
// the step itself is differentiated; the derivatives have its order, 2s - 1.
//
// At the end of the step, dP_s is projected onto Φ, and dV_s onto the hidden constraint, by [[M, -G], [J, 0]] at (p₁, v₁).
// The run moves the velocity by δ = v₁ - V_s = M⁻¹ G ν, with M at a configuration that also depends on θ:
//
//     M (s_v1 - dV_s) - G dν + q_θ + ∂q/∂ξ s_p1 = 0,    q = M δ - G ν,      J s_v1 + H s_p1 + ρ_θ = 0.
//
// Without q, whose size is of the order of V_s, the derivatives would have the order of the unprojected stages. No history
// is needed; the multipliers are those of the index-1 equations, at any state.
//
// Here: derivatives of residuals by parameters (gradients/variants.py), and of rows by the state.
#pragma once

#include "system.hpp"

namespace pinconsist {

// Known derivatives of f by parameters, a column each.
class Known {
public:
  virtual ~Known() = default;
  virtual bool calls_python() const = 0;
  // Add r_θ to columns.
  virtual void add_columns(double t, const Vec &p, const Vec &v, const Vec &a, Eigen::Ref<Mat> r) = 0;
  // Add wᵀ r_θ.
  virtual void contract(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &w, Eigen::Ref<Vec> rates) = 0;
};

// A function that returns (r, Φ, ρ) of a mechanism at the point evaluated last, with r = f - G λ.
inline auto residuals_with(Vec lam) {
  return [lam = std::move(lam)](const System &system) {
    Vec all(system.nv + 2 * system.nc);
    all << system.f - system.G_transposed().transpose() * lam, system.phi, system.rho;
    return all;
  };
}

// The effect of parameters on the residuals: for each, weighted residuals of neighbouring mechanisms, or known
// derivatives of f.
class Parameters {
public:
  Known *known = nullptr;

  void use(int number) { size_ = number; }
  // Terms of one column must be added one after another.
  void add_term(int column, double weight, System &other) { terms_.push_back({column, weight, &other}); }
  int size() const { return size_; }
  bool move_rows() const { return !terms_.empty(); } // known derivatives are those of f
  bool calls_python() const {
    bool any = known && known->calls_python();
    for (const auto &term : terms_) any = any || term.other->calls_python();
    return any;
  }

  // Add the derivatives of residuals at a state to columns, r first; residual(mechanism) returns those of an evaluated one.
  template <class Residual>
  void add_columns(double t, const Vec &p, const Vec &v, const Vec &a, const Residual &residual, Eigen::Ref<Mat> columns) const {
    if (known) known->add_columns(t, p, v, a, columns.topRows(v.size()));
    for (const auto &[column, weight, other] : terms_) {
      other->evaluate(t, p, v, a);
      columns.col(column) += weight * residual(*other);
    }
  }
  // Add their products with weights.
  template <class Residual>
  void contract(double t, const Vec &p, const Vec &v, const Vec &a, const Residual &residual, const Vec &weights,
                Eigen::Ref<Vec> rates) const {
    if (known) known->contract(t, p, v, a, weights.head(v.size()), rates);
    Vec rate(weights.size()); // differences first, as in columns
    for (auto term = terms_.begin(); term != terms_.end();) {
      rate.setZero();
      const int column = term->column;
      for (; term != terms_.end() && term->column == column; ++term) {
        term->other->evaluate(t, p, v, a);
        rate += term->weight * residual(*term->other);
      }
      rates[column] += rate.dot(weights);
    }
  }

private:
  struct Term {
    int column;
    double weight;
    System *other;
  };

  int size_ = 0;
  std::vector<Term> terms_;
};

// β = J a + γ
inline Vec beta(System &system, double t, const Vec &p, const Vec &v, const Vec &a) {
  Vec beta;
  system.evaluate_bias(t, p, v, false, beta);
  beta += system.G_transposed() * a;
  return beta;
}

// Derivatives of constraint rows, known or by central differences; coordinates that share no row are moved together.
class RowGradients {
public:
  explicit RowGradients(System &system) : system_(system) {}

  // F = ∂(G λ)/∂ξ and H = ∂ρ/∂ξ at the point evaluated last; another point may be evaluated last afterwards.
  void find(double t, const Vec &p, const Vec &v, const Vec &lam, Mat &F, Mat &H) {
    for (int known = 1; known >= 0; --known) {
      F.setZero(system_.nv, system_.nx);
      H.setZero(system_.nc, system_.nx);
      if (known && system_.row_gradients(t, p, v, lam, F, H)) return;
    }
    begin(t, p, v);
    for (const auto &members : groups_) {
      differences(members, ROW_STEP, [&](const Vec &way) {
        system_.integrate(p, way, there_);
        system_.constraint(t, there_, v);
        return std::pair<const Vec &, const Mat &>(system_.rho, system_.G_transposed());
      });
      put(members, lam, F, H);
    }
  }

  // F alone.
  void find_forces(double t, const Vec &p, const Vec &v, const Vec &lam, Mat &F) {
    F.setZero(system_.nv, system_.nx);
    if (!system_.row_gradients(t, p, v, lam, F, none_)) find(t, p, v, lam, F, spare_);
  }

  // F, and the derivatives of β by ξ and by v; β is quadratic in v.
  void find_second(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, Mat &F, Mat &by_p, Mat &by_v) {
    begin(t, p, v);
    F.setZero(system_.nv, system_.nx);
    by_p.setZero(system_.nc, system_.nx);
    by_v.setZero(system_.nc, system_.nv);
    Mat none;
    const double size = 1.0 + largest(v);
    for (const auto &members : groups_) {
      differences(members, ROW_STEP, [&](const Vec &way) {
        system_.integrate(p, way, there_);
        return second(t, there_, v, a);
      });
      put(members, lam, F, by_p);
      differences(members, size, [&](const Vec &way) { return second(t, p, v + way, a); });
      put(members, lam, none, by_v);
    }
  }

private:
  static constexpr double ROW_STEP = 3e-5; // rad or m: step of the differences of rows, which are exact to 2e-10 of their size

  std::pair<const Vec &, const Mat &> second(double t, const Vec &p, const Vec &v, const Vec &a) {
    beta_ = beta(system_, t, p, v, a);
    return {beta_, system_.G_transposed()};
  }

  template <class Function> void differences(const std::vector<int> &members, double size, const Function &function) {
    rates_.setZero(system_.nc);
    change_.setZero(system_.nc, system_.nv);
    for (double side : {1.0, -1.0}) {
      way_.setZero(system_.nx);
      for (int j : members) way_[j] = side * size;
      const auto [value, Gt] = function(way_);
      rates_ += (0.5 * side / size) * value;
      change_ += (0.5 * side / size) * Gt;
    }
  }

  void put(const std::vector<int> &members, const Vec &lam, Mat &F, Mat &H) const {
    for (int j : members)
      for (int i : moved_rows_[j]) {
        H(i, j) = rates_[i];
        if (F.size()) F.col(j) += lam[i] * change_.row(i).transpose();
      }
  }

  // Groups of coordinates no two of which change the same row, found from J and its changes away from special
  // positions: a rotation also changes rows of J in which it does not appear. Coordinates that change no row are in no
  // group.
  void begin(double t, const Vec &p, const Vec &v) {
    const int nx = system_.nx, nc = system_.nc;
    there_.resize(system_.npos);
    if (!groups_.empty() || !nc) return;
    Mat touched = Mat::Zero(nc, nx);
    if (system_.calls_python()) touched.setOnes(); // user-defined rows need not be defined there
    else
      for (int place = 0; place < 3; ++place) {
        const Vec way = (Vec::LinSpaced(nx, 1.0, nx).array() * 2.3 + 7.0 * place).sin();
        system_.integrate(p, way, there_);
        system_.constraint(t, there_, v);
        const Vec here = there_;
        const Mat J = system_.W;
        touched += J.cwiseAbs();
        for (int j = 0; j < nx; ++j) {
          system_.integrate(here, 0.3 * Vec::Unit(nx, j), there_);
          system_.constraint(t, there_, v);
          touched.col(j) += (system_.W - J).cwiseAbs().rowwise().sum();
        }
      }
    moved_rows_.assign(nx, {});
    std::vector<std::vector<bool>> taken;
    for (int j = 0; j < nx; ++j) {
      for (int i = 0; i < nc; ++i)
        if (touched(i, j) > 1e-11) moved_rows_[j].push_back(i);
      if (moved_rows_[j].empty()) continue;
      size_t free = 0;
      const auto meets = [&](const std::vector<bool> &rows) {
        for (int i : moved_rows_[j])
          if (rows[i]) return true;
        return false;
      };
      while (free < taken.size() && meets(taken[free])) ++free;
      if (free == taken.size()) {
        taken.emplace_back(nc, false);
        groups_.emplace_back();
      }
      groups_[free].push_back(j);
      for (int i : moved_rows_[j]) taken[free][i] = true;
    }
  }

  System &system_;
  Vec there_, way_, rates_, beta_;
  Mat change_, none_, spare_;
  std::vector<std::vector<int>> groups_, moved_rows_;
};

} // namespace pinconsist
