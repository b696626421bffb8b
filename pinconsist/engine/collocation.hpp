// The collocation polynomial of a step: extended to the next one, and evaluated between its ends.
#pragma once

#include "index1.hpp"
#include "stages.hpp"
#include "stiff_forces.hpp"

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

// The accelerations of a step: at its stages, and those of the differential equation at its ends, which are better.
struct Shape {
  const RadauTable *table = nullptr;
  double t = 0.0, h = 0.0;
  Mat W;
  Vec start, end;

  // The coefficients of the polynomial's modes: they decay where it is accurate.
  void coefficients(Mat &out) const {
    const auto s = W.cols();
    static thread_local Mat all, plain;
    all.resize(W.rows(), s + 1);
    all << start, W.leftCols(s - 1), end;
    combine(all, table->raised, out);
    combine(W, table->modes, plain);
    const auto last_two = [&](const Mat &of, Eigen::Index i) {
      return std::max(std::abs(of(i, s - 1)), s > 1 ? std::abs(of(i, s - 2)) : 0.0);
    };
    double most = 0.0;
    for (Eigen::Index i = 0; i < W.rows(); ++i) most = std::max(most, last_two(out, i));
    bool fits = true;
    for (Eigen::Index i = 0; i < W.rows(); ++i) {
      const double apart = std::max(std::abs(start[i] - W.row(i).dot(table->at_start)), std::abs(end[i] - W(i, s - 1)));
      const double last = std::max(last_two(out, i), NOTABLE * most);
      fits = fits && apart <= FITTING * last_two(plain, i) && std::abs(out(i, s)) <= RESOLVED * last;
    }
    for (Eigen::Index i = 0; i < W.rows(); ++i)
      if (!fits || std::abs(out(i, s)) > RESOLVED * last_two(out, i)) out.row(i) << plain.row(i), 0.0;
  }

  // Their polynomial at the stages of another step.
  void predict(Stages &stages) const {
    const int n = table->s + 1;
    static thread_local Mat of_modes, values;
    values.resize(stages.size(), n);
    coefficients(of_modes);
    for (int i = 0; i < stages.size(); ++i) values.row(i) = legendre((stages.time(i) - t) / h, n).transpose();
    combine(of_modes, values, stages.W);
  }
};

// The integrals of the first n of them up to a fraction of the step.
inline FewNumbers integrals(double theta, int n) {
  const FewNumbers P = legendre(theta, n + 1);
  FewNumbers of_modes(n);
  for (int k = 0; k < n; ++k) of_modes[k] = 0.5 * (P[k + 1] - (k ? P[k - 1] : -1.0)) / (2 * k + 1);
  return of_modes;
}

// The collocation polynomial of a step, bent to its projected end.
struct Collocation {
  Shape shape;
  Mat U; // rates of ξ at the stages
  Vec p0, v0, p1, v1;
  bool stiff = false; // what its projection moved along stiff forces was taken back
  std::shared_ptr<const Collocation> halves[2]; // null where the polynomial is accurate between the ends
};
using Collocations = std::vector<std::shared_ptr<const Collocation>>; // of successive steps

// The step itself, or the half of it that holds a time.
inline const Collocations::value_type &holder(const Collocations::value_type &step, double t) {
  if (!step->halves[0]) return step;
  const Shape &second = step->halves[1]->shape;
  return step->halves[(t - second.t) * second.h > 0.0];
}

// States inside steps, projected onto the constraints, as long as the equations exist.
class Sampler {
public:
  explicit Sampler(System &system) : system_(system), stiff_forces_(system), index1_(system) {}

  const System &system() const { return system_; }

  // p, v and λ at a time within a step; false if the equations are singular.
  bool sample(const Collocations::value_type &of, double t) {
    const auto &step = holder(of, t);
    interpolate(step, t);
    return settle(*step, t);
  }

  // The same without projection, and with λ only if requested.
  bool look(const Collocations::value_type &of, double t, bool with_multipliers) {
    interpolate(of, t);
    return !with_multipliers || index1_.acceleration(t, p, v, a_, lam);
  }

  // An estimate of the error of v between the ends. It is the geometric mean of two: that from the decay of the modes is
  // too small with stiff forces, that from the defect of the accelerations too large.
  double error_between(const Collocations::value_type &of, const Vec &weight) {
    const Shape &shape = of->shape;
    const int s = shape.table->s;
    if (s < 3) return 0.0;
    const double theta = shape.table->between_stages(), h = std::abs(shape.h) / (2 * s);
    interpolate(of, shape.t + theta * shape.h);
    const auto size = [&](const auto &a) { return h * a.cwiseProduct(weight).norm() / std::sqrt(system_.nv); };
    const auto mode = [&](int k) { return size(accelerations_.col(k)); };
    const double last = std::hypot(mode(s), mode(s - 1)), before = std::hypot(mode(s - 2), mode(s - 3));
    const double next = last * std::min(1.0, last / (before + 1e-300));
    if (!(next > NEXT_MODE * BETWEEN)) return 0.0;
    const double t = shape.t + theta * shape.h;
    if (!settle(*of, t) || !index1_.acceleration(t, p, v, a_, lam)) return 0.0;
    a_ -= accelerations_ * legendre(theta, s + 1) + 6.0 * theta * (1.0 - theta) / shape.h * missing_v_;
    return std::sqrt(next * size(a_));
  }

  Vec p, v, lam;

private:
  // Project, as at the end of the step, and compute λ.
  bool settle(const Collocation &step, double t) {
    before_ = v;
    if (!index1_.settle(t, p, v, lam)) return false;
    if (!step.stiff) return true;
    const Shape &shape = step.shape;
    for (Mat *each : {&M_, &D_, &K_}) each->resize(system_.nv, system_.nv);
    a_ = accelerations_ * legendre((t - shape.t) / shape.h, shape.table->s + 1);
    system_.evaluate_parts(t, p, before_, a_, M_, D_, K_); // the projection may have moved v out of the stiff range
    stiff_forces_.set(D_, K_, shape.h);
    stiff_forces_.take_back(M_, v - before_, v);
    return index1_.acceleration(t, p, v, a_, lam);
  }

  void interpolate(const Collocations::value_type &of, double t) {
    const Collocation &step = *of;
    const Shape &shape = step.shape;
    const int s = shape.table->s;
    if (of != last_) {
      last_ = of;
      combine(step.U, shape.table->modes, rates_);
      shape.coefficients(accelerations_);
      missing_.resize(system_.nx);
      system_.difference(step.p0, step.p1, missing_);
      missing_ -= shape.h * rates_.col(0); // the other polynomials have no integral over the step
      missing_v_ = step.v1 - step.v0 - shape.h * accelerations_.col(0);
    }
    const double theta = (t - shape.t) / shape.h, bend = theta * theta * (3.0 - 2.0 * theta);
    const FewNumbers here = shape.h * integrals(theta, s + 1);
    xi_ = bend * missing_ + rates_.lazyProduct(here.head(s));
    system_.integrate(step.p0, xi_, p);
    v = step.v0 + bend * missing_v_ + accelerations_.lazyProduct(here);
  }

  System &system_;
  StiffForces stiff_forces_;
  Projection index1_;
  Collocations::value_type last_; // of which the following are kept
  Vec missing_, missing_v_;
  Mat rates_, accelerations_; // coefficients of Legendre polynomials
  Mat M_, D_, K_;
  Vec xi_, a_, before_;
};

} // namespace pinconsist
