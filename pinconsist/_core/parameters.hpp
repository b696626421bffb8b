// The parameters of derivatives, and what they change in the residuals (gradients/varied.py).
#pragma once

#include "system.hpp"

namespace pinconsist {

// Derivatives of f by parameters that are known, a column each.
class Known {
public:
  virtual ~Known() = default;
  virtual bool calls_python() const = 0;
  // Add r_θ to columns.
  virtual void add_columns(double t, const Vec &p, const Vec &v, const Vec &a, Eigen::Ref<Mat> r) = 0;
  // Add wᵀ r_θ.
  virtual void contract(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &w, Eigen::Ref<Vec> rates) = 0;
};

// The effect of parameters on the residuals: for each, weighted residuals of neighbouring mechanisms, or known
// derivatives of f.
class Parameters {
public:
  Known *known = nullptr;

  void use(int number) { size_ = number; }
  // Terms of one column must be added one after another.
  void add_term(int column, double weight, System &other) { terms_.push_back({column, weight, &other}); }
  int size() const { return size_; }
  bool calls_python() const {
    bool any = known && known->calls_python();
    for (const auto &term : terms_) any = any || term.other->calls_python();
    return any;
  }

  // Add (r_θ, Φ_θ, ρ_θ) at a state to columns, r = f - G λ.
  void add_columns(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, Eigen::Ref<Mat> r, Eigen::Ref<Mat> phi,
                   Eigen::Ref<Mat> rho) const {
    if (known) known->add_columns(t, p, v, a, r);
    for (const auto &term : terms_) {
      const int k = term.column;
      add(term, t, p, v, a, lam, r.col(k), phi.col(k), rho.col(k));
    }
  }
  // Add their products with weights.
  void contract(double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, const Vec &of_r, const Vec &of_phi,
                const Vec &of_rho, Eigen::Ref<Vec> rates) const {
    if (known) known->contract(t, p, v, a, of_r, rates);
    Vec r(of_r.size()), phi(of_phi.size()), rho(of_rho.size()); // differences first, as in columns
    for (auto term = terms_.begin(); term != terms_.end();) {
      r.setZero();
      phi.setZero();
      rho.setZero();
      const int k = term->column;
      for (; term != terms_.end() && term->column == k; ++term) add(*term, t, p, v, a, lam, r, phi, rho);
      rates[k] += r.dot(of_r) + phi.dot(of_phi) + rho.dot(of_rho);
    }
  }
  // All neighbouring mechanisms at a state.
  template <class Take> void each(double t, const Vec &p, const Vec &v, const Vec &a, const Take &take) const {
    for (const auto &term : terms_) {
      term.other->evaluate(t, p, v, a);
      take(term.column, term.weight, *term.other);
    }
  }

private:
  struct Term {
    int column;
    double weight;
    System *other;
  };

  static void add(const Term &term, double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, Eigen::Ref<Vec> r, Eigen::Ref<Vec> phi,
                  Eigen::Ref<Vec> rho) {
    auto &other = *term.other;
    other.evaluate(t, p, v, a);
    r += term.weight * (other.f - other.G_transposed().transpose() * lam);
    phi += term.weight * other.phi;
    rho += term.weight * other.rho;
  }

  int size_ = 0;
  std::vector<Term> terms_;
};

} // namespace pinconsist
