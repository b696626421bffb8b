// mechanism/lie.py and chart_matrix of dae/charts.py.
#pragma once

#include "system.hpp"

#include <pinocchio/algorithm/joint-configuration.hpp>

namespace pinconsist {

class LieGroup {
public:
  explicit LieGroup(const pinocchio::Model &model) : nv_(model.nv) {
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
  Vec chart_rate(const Vec &xi, const Vec &rate) const {
    Vec power = rate, sum = rate + 0.5 * bracket_of(xi, rate);
    for (double weight : bernoulli()) {
      power = bracket_of(xi, bracket_of(xi, power));
      const Vec term = weight * power;
      sum += term;
      if (!(largest(term) > EPS * largest(sum))) break;
    }
    return sum;
  }

private:
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

  struct Constant {
    int i, j, k;
    double size;
  };

  Vec bracket_of(const Vec &x, const Vec &y) const {
    Vec z = Vec::Zero(nv_);
    for (const auto &[i, j, k, size] : constants_) z[k] += size * x[i] * y[j];
    return z;
  }

  int nv_;
  std::vector<Constant> constants_;
};

} // namespace pinconsist
