// chart_matrix and chart_rate_gradient of engine/charts.py.
#pragma once

#include "system.hpp"

namespace pinconsist {

// B₂ₙ/(2n)!, n = 1 ... 39: the coefficients of x/2 coth(x/2).
inline const std::vector<double> &bernoulli() {
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

// T of the joint with this ad ξ.
template <class Block> Block chart_block(const Block &ad) {
  const Block square = ad * ad;
  Block T = Block::Identity(ad.rows(), ad.cols()) + 0.5 * ad, power = square;
  for (double weight : bernoulli()) {
    T += weight * power;
    if (!(std::abs(weight) * largest(power) > EPS)) break;
    power = (power * square).eval();
  }
  return T;
}

// ∂(T rate)/∂ξ, chart_rate_gradient of engine/charts.py.
inline void chart_rate_gradient(const System &system, const Vec &xi, const Vec &rate, Mat &total) {
  Mat ad, of_power, change = Mat::Zero(system.nx, system.nx);
  Vec power = rate;
  system.bracket(xi, ad);
  system.bracket(rate, of_power);
  total = -0.5 * of_power;
  for (double weight : bernoulli()) {
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
