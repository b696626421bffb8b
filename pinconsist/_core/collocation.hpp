// The collocation polynomial of a step: led on to the next one, and RadauSegment of dae/dense.py at many times.
#pragma once

#include "index1.hpp"
#include "stages.hpp"

namespace pinconsist {

// Shifted Legendre polynomials of degree below n at a part of the step.
inline Vec legendre(double theta, int n) {
  const double x = 2.0 * theta - 1.0;
  Vec values(n);
  values[0] = 1.0;
  if (n > 1) values[1] = x;
  for (int j = 2; j < n; ++j) values[j] = ((2 * j - 1) * x * values[j - 1] - (j - 1) * values[j - 2]) / j;
  return values;
}

// The accelerations of a step.
struct Shape {
  const RadauTable *table = nullptr;
  double t = 0.0, h = 0.0;
  Mat W;

  // Their polynomial at the stages of another step.
  void predict(Stages &stages) const {
    Mat values(table->s, stages.size());
    for (int i = 0; i < stages.size(); ++i)
      values.col(i).noalias() = table->modes.transpose().lazyProduct(legendre((stages.time(i) - t) / h, table->s));
    stages.W = W.lazyProduct(values);
  }
};

// Weights b with which values at the nodes become the integral of their polynomial up to a part of the step.
inline Vec integrals(const RadauTable &table, double theta) {
  const Vec P = legendre(theta, table.s + 1);
  Vec of_modes(table.s);
  for (int k = 0; k < table.s; ++k) of_modes[k] = 0.5 * (P[k + 1] - (k ? P[k - 1] : -1.0)) / (2 * k + 1);
  return table.modes.transpose() * of_modes;
}

// States inside steps; of a system of its own, which may outlive the run.
class Sampler {
public:
  explicit Sampler(System &system) : system_(system), index1_(system) {}

  // p, v and λ at `times` of the step from (p0, v0) to (p1, v1), a row each; false where the equations are singular.
  bool sample(const RadauTable &table, const Shape &step, const Mat &U, const Vec &p0, const Vec &v0, const Vec &p1,
              const Vec &v1, const Vec &times, Table &p, Table &v, Table &lam) {
    const double h = step.h;
    const Vec last = h * table.A.row(table.s - 1).transpose();
    Vec missing(system_.nx), at_p, at_v, a, at_lam;
    system_.difference(p0, p1, missing);
    missing -= U * last;
    const Vec missing_v = v1 - v0 - step.W * last;
    for (Eigen::Index i = 0; i < times.size(); ++i) {
      const double theta = (times[i] - step.t) / h;
      const Vec here = h * integrals(table, theta), xi = U * here + theta * theta * (3.0 - 2.0 * theta) * missing;
      system_.integrate(p0, xi, at_p);
      at_v = v0 + step.W * here + theta * theta * missing_v;
      if (!index1_.acceleration(times[i], at_p, at_v, a, at_lam)) return false;
      p.row(i) = at_p.transpose();
      v.row(i) = at_v.transpose();
      lam.row(i) = at_lam.transpose();
    }
    return true;
  }

private:
  System &system_;
  Projection index1_;
};

} // namespace pinconsist
