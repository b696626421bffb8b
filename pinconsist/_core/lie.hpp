// mechanism/lie.py and chart_matrix of dae/charts.py.
#pragma once

#include "system.hpp"

#include <pinocchio/algorithm/joint-configuration.hpp>

namespace pinconsist {

class LieGroup {
public:
  explicit LieGroup(const pinocchio::Model &model) : nv_(model.nv), power_(nv_), next_(nv_) {
    const double s = 1e-3;
    const Vec q = pinocchio::neutral(model);
    Mat ahead = Mat::Zero(nv_, nv_), back = ahead;
    if (model.nq == nv_) return;
    for (int i = 0; i < nv_; ++i) {
      const Vec unit = s * Vec::Unit(nv_, i);
      pinocchio::dIntegrate(model, q, unit, ahead, pinocchio::ARG0);
      pinocchio::dIntegrate(model, q, Vec(-unit), back, pinocchio::ARG0);
      const Mat C = ((back - ahead) / (2.0 * s)).array().round();
      for (int k = 0; k < nv_; ++k)
        for (int j = 0; j < nv_; ++j)
          if (C(k, j) != 0.0) constants_.push_back({i, j, k, C(k, j)});
    }
  }

  // ad x: the matrix of [x, ·].
  void bracket(const Vec &x, Mat &ad) const {
    ad.setZero(nv_, nv_);
    for (const auto &[i, j, k, size] : constants_) ad(k, j) += size * x[i];
  }

  // T rate, with T = ad/(1 - exp(-ad)), ad = ad ξ.
  void chart_rate(const Vec &xi, const Vec &rate, Vec &out) const {
    out = rate;
    if (constants_.empty()) return;
    power_ = rate;
    bracket(xi, power_, next_);
    out += 0.5 * next_;
    for (double weight : bernoulli()) {
      bracket(xi, power_, next_);
      bracket(xi, next_, power_);
      out += weight * power_;
      if (!(std::abs(weight) * largest(power_) > EPS * largest(out))) break;
    }
  }

  // T of the joint with this ad ξ.
  template <class Block> static Block chart_block(const Block &ad) {
    const Block square = ad * ad;
    Block T = Block::Identity(ad.rows(), ad.cols()) + 0.5 * ad, power = square;
    for (double weight : bernoulli()) {
      T += weight * power;
      if (!(std::abs(weight) * largest(power) > EPS)) break;
      power = (power * square).eval();
    }
    return T;
  }

  // B₂ₙ/(2n)!, n = 1 ... 39: the coefficients of x/2 coth(x/2).
  static const std::vector<double> &bernoulli() {
    static const std::vector<double> numbers = [] {
      std::vector<double> b{1.0}, sinh{1.0};
      double cosh = 1.0;
      for (int n = 1; n < 40; ++n) {
        cosh /= 4.0 * (2 * n - 1) * (2 * n);
        sinh.push_back(cosh / (2 * n + 1));
        double rest = cosh;
        for (int k = 0; k < n; ++k) rest -= b[k] * sinh[n - k];
        b.push_back(rest);
      }
      b.erase(b.begin());
      return b;
    }();
    return numbers;
  }

private:
  struct Constant {
    int i, j, k;
    double size;
  };

  void bracket(const Vec &x, const Vec &y, Vec &z) const {
    z.setZero();
    for (const auto &[i, j, k, size] : constants_) z[k] += size * x[i] * y[j];
  }

  int nv_;
  std::vector<Constant> constants_;
  mutable Vec power_, next_;
};

// ∂(T rate)/∂ξ, chart_rate_gradient of dae/charts.py.
inline void chart_rate_gradient(const System &system, const Vec &xi, const Vec &rate, Mat &total) {
  Mat ad, of_power, change = Mat::Zero(system.nx, system.nx);
  Vec power = rate;
  system.bracket(xi, ad);
  system.bracket(rate, of_power);
  total = -0.5 * of_power;
  for (double weight : LieGroup::bernoulli()) {
    for (int i = 0; i < 2; ++i) {
      system.bracket(power, of_power);
      power = ad * power;
      change = ad * change - of_power;
    }
    total += weight * change;
    if (std::abs(weight) * largest(change) <= EPS * largest(total)) break;
  }
}

} // namespace pinconsist
