// mechanism/lie.py.
#pragma once

#include "charts.hpp"
#include "tree.hpp"

namespace pinconsist {

class LieGroup {
public:
  explicit LieGroup(const Model &model) : nv_(model.nv), power_(nv_), next_(nv_) {
    const double s = 1e-3;
    const Vec q = library::neutral(model);
    Mat ahead = Mat::Zero(nv_, nv_), back = ahead;
    if (model.nq == nv_) return;
    for (int i = 0; i < nv_; ++i) {
      const Vec unit = s * Vec::Unit(nv_, i);
      library::differentiate_integration(model, q, unit, ahead);
      library::differentiate_integration(model, q, -unit, back);
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

} // namespace pinconsist
