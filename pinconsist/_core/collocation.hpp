// The collocation polynomial of a step: extended to the next one, and RadauSegment of dae/segments.py at many times.
#pragma once

#include "index1.hpp"
#include "stages.hpp"

#include <memory>

namespace pinconsist {

using FewNumbers = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 16, 1>; // one per stage, without heap memory

// Shifted Legendre polynomials of degree below n at a fraction of the step.
inline FewNumbers legendre(double theta, int n) {
  const double x = 2.0 * theta - 1.0;
  FewNumbers values(n);
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
    Mat coefficients, values(stages.size(), table->s);
    combine(W, table->modes, coefficients);
    for (int i = 0; i < stages.size(); ++i) values.row(i) = legendre((stages.time(i) - t) / h, table->s).transpose();
    combine(coefficients, values, stages.W);
  }
};

// The integrals of the first s of them up to a fraction of the step.
inline FewNumbers integrals(double theta, int s) {
  const FewNumbers P = legendre(theta, s + 1);
  FewNumbers of_modes(s);
  for (int k = 0; k < s; ++k) of_modes[k] = 0.5 * (P[k + 1] - (k ? P[k - 1] : -1.0)) / (2 * k + 1);
  return of_modes;
}

// The collocation polynomial of a step, bent to its projected end.
struct Collocation {
  Shape shape;
  Mat U; // rates of ξ at the stages
  Vec p0, v0, p1, v1;
};
using Collocations = std::vector<std::shared_ptr<const Collocation>>; // of successive steps

// dae/events.py: the zero of g between a and b, where its signs differ, and its value there.
template <class G> std::pair<double, double> zero(const G &g, double a, double fa, double b, double fb, double near) {
  double part = fa / (fa - fb);
  for (int tries = 1;; ++tries) {
    const double least = 0.5 * near / std::abs(b - a);
    const double t = a + std::min(std::max(part, least), 1.0 - least) * (b - a), f = g(t);
    double c = a, fc = fa;
    if (!(f * fa > 0.0)) {
      std::swap(c, b);
      std::swap(fc, fb);
    }
    a = t;
    fa = f;
    if (fa == 0.0 || std::abs(b - a) <= near) break;
    const double x = (a - b) / (c - b), y = (fa - fb) / (fc - fb);
    part = tries < HALVING && y * y < x && (1.0 - y) * (1.0 - y) < 1.0 - x
               ? fa / (fa - fb) * fc / (fc - fb) - (c - a) / (b - a) * fa / (fc - fa) * fb / (fb - fc)
               : 0.5;
  }
  return std::abs(fa) < std::abs(fb) ? std::pair{a, fa} : std::pair{b, fb};
}

// States inside steps, projected onto the constraints, as long as the equations exist.
class Sampler {
public:
  explicit Sampler(System &system) : system_(system), index1_(system) {}

  const System &system() const { return system_; }

  // p, v and λ at a time within a step; false if the equations are singular.
  bool sample(const Collocations::value_type &of, double t) {
    interpolate(of, t);
    return index1_.settle(t, p, v, lam);
  }

  // The same without projection, and with λ only if requested.
  bool look(const Collocations::value_type &of, double t, bool with_multipliers) {
    interpolate(of, t);
    return !with_multipliers || index1_.acceleration(t, p, v, a_, lam);
  }

  Vec p, v, lam;

private:
  void interpolate(const Collocations::value_type &of, double t) {
    const Collocation &step = *of;
    const Shape &shape = step.shape;
    const RadauTable &table = *shape.table;
    if (of != last_) {
      last_ = of;
      const Vec whole = shape.h * table.A.row(table.s - 1).transpose();
      missing_.resize(system_.nx);
      system_.difference(step.p0, step.p1, missing_);
      missing_ -= step.U * whole;
      missing_v_ = step.v1 - step.v0 - shape.W * whole;
      combine(step.U, table.modes, rates_);
      combine(shape.W, table.modes, accelerations_);
    }
    const double theta = (t - shape.t) / shape.h;
    const FewNumbers here = shape.h * integrals(theta, table.s);
    xi_ = theta * theta * (3.0 - 2.0 * theta) * missing_ + rates_.lazyProduct(here);
    system_.integrate(step.p0, xi_, p);
    v = step.v0 + theta * theta * missing_v_ + accelerations_.lazyProduct(here);
  }

  System &system_;
  Projection index1_;
  Collocations::value_type last_; // of which the following are kept
  Vec missing_, missing_v_;
  Mat rates_, accelerations_; // coefficients of Legendre polynomials
  Vec xi_, a_;
};

} // namespace pinconsist
