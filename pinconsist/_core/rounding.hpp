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

// What rounding does to v, also by way of the constraint rows; infinite where the equations are singular.
inline double velocity_rounding(System &system, KKT &kkt, double t, const Vec &p, const Vec &v) {
  const int nv = system.nv, nc = system.nc;
  const double speed = largest(v), reach = 1.0 + largest(p);
  if (!nc) return EPS * speed;
  system.constraint(t, p, v);
  const Vec here = system.rho;
  Mat solved = Mat::Zero(nv + nc, nc);
  solved.bottomRows(nc).setIdentity();
  system.mass_matrix(t, p, v, kkt.A());
  if (!kkt.solve_new(system.W, system.G_transposed(), 1.0, solved, nc)) return INF;
  const auto closing = solved.topRows(nv);
  int farthest;
  closing.cwiseAbs().rowwise().sum().maxCoeff(&farthest);
  const Vec moved = closing * closing.row(farthest).cwiseSign().transpose();
  const double share = TURNED * reach / largest(moved);
  Vec there, xi;
  system.position(t, p, Vec::Zero(system.nx), share, moved, there, xi);
  system.constraint(t, there, v);
  return EPS * (speed + reach * largest(closing * (system.rho - here)) / share);
}

// Whether the error of a step is rounding of the velocities; what it does to them is measured.
class RoundingTest {
public:
  void restart() { noise_ = 0.0; }

  template <class Explained, class Noise>
  bool passes(double error, double speed, const Explained &explained, const Noise &noise) {
    if (error > explained(HALF * speed)) return false;
    if (error > explained(noise_)) noise_ = std::max(noise_, SURE * noise());
    return error <= explained(noise_);
  }

  void accepted() { noise_ *= 0.5; }

private:
  double noise_ = 0.0; // in v of the last steps; a step's noise fades from the differences after it
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
