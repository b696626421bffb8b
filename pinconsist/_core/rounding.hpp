// dae/rounding.py: to what size it is iterated, when an error is rounding, and when a run makes no headway.
#pragma once

#include "kkt.hpp"
#include "system.hpp"

namespace pinconsist {

inline double spacing(double t) { return std::nextafter(std::abs(t), INF) - std::abs(t); }
inline double shortest_step(double t) { return SMALLEST_STEP * spacing(t); }

// Weights with which Newton runs down to rounding; returns its tolerance.
inline double rounding_weights(const System &system, const Vec &y, Vec &weight) {
  const double size_v = largest(y.segment(system.nx, system.nv));
  weight.resize(system.nx + system.nv);
  weight.head(system.nx).setConstant(1.0 / (1.0 + largest(y.head(system.nx))));
  weight.tail(system.nv).setConstant(1.0 / (size_v == 0.0 ? 1.0 : size_v));
  return 2.0 * EPS;
}

inline double rounding_gap(const Vec &p, const Mat &W) { return GAP * (1.0 + largest(p)) * (1.0 + largest(W)); }

// Velocity that eps in v and in Φ brings about; 0 where loops are open, infinite where the equations are singular.
inline double velocity_rounding(System &system, KKT &kkt, double t, const Vec &p, const Vec &v) {
  const int nv = system.nv, nc = system.nc;
  const double size = EPS * largest(v);
  if (!nc) return size;
  system.constraint(t, p, v);
  Mat inverse = Mat::Zero(nv + nc, nc);
  inverse.bottomRows(nc).setIdentity();
  system.mass_matrix(t, p, v, kkt.A());
  const bool regular = kkt.solve_new(system.W, system.G_transposed(), 1.0, inverse, nc);
  if (largest(system.phi) > rounding_gap(p, system.G_transposed())) return 0.0;
  if (!regular) return INF;
  const double s = inverse.topRows(nv).cwiseAbs().rowwise().sum().maxCoeff();
  return size * (1.0 + (1.0 + largest(p)) * s * s * system.W.cwiseAbs().rowwise().sum().maxCoeff());
}

class RoundingTest {
public:
  void restart() {
    believed_ = 0.0;
    steps_left_ = 0;
  }

  template <class Bound>
  bool passes(double tightest, double h, int k, double error, double longer, double its_error, const Bound &bound) {
    h = std::abs(h);
    if (tightest > NEAR_ROUNDING) return false;
    const bool shown = h < longer && error >= its_error * std::pow(h / longer, SLOW * (k + 1));
    const bool known = steps_left_ > 0 && h <= believed_;
    const auto [explained, singular] = bound();
    if (error > explained || !(shown || known || (singular && error * SURE <= explained))) return false;
    if (shown) {
      believed_ = std::max(known ? believed_ : 0.0, longer);
      steps_left_ = static_cast<int>(REMEMBERED);
    }
    return true;
  }

  void accepted() { --steps_left_; }

private:
  double believed_ = 0.0; // up to which step rounding has shown itself, and for how long
  int steps_left_ = 0;
};

class Headway {
public:
  void restart(double start, double t) {
    start_ = start;
    counted_from_ = t;
    setbacks_ = 0;
  }
  bool setback() { return ++setbacks_ > SETBACKS; }
  void reached(double t) {
    if (std::abs(t - counted_from_) > PROGRESS * std::abs(t - start_)) counted_from_ = t, setbacks_ = 0;
  }

private:
  double start_ = 0.0, counted_from_ = 0.0;
  int setbacks_ = 0;
};

} // namespace pinconsist
