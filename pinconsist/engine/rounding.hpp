// How far to iterate, when an error is rounding, and when a run makes no progress.
#pragma once

#include "kkt.hpp"
#include "system.hpp"

namespace pinconsist {

constexpr double TO_ROUNDING = 2.0 * EPS;

inline double spacing(double t) { return std::nextafter(std::abs(t), INF) - std::abs(t); }
inline double shortest_step(double t) { return SMALLEST_STEP * spacing(t); }
// h, rounded so that the time of a run does not drift away from the sum of its steps, unless that is far too little.
inline double representable(double t, double h) {
  return spacing(t) > DRIFT * std::abs(h) ? (2.0 * t + h) - 2.0 * t : h;
}

// Weights with which Newton iterates down to rounding; returns its tolerance.
inline double rounding_weights(const System &system, const Vec &y, Vec &weight) {
  const double size_v = largest(y.segment(system.nx, system.nv));
  weight.resize(system.nx + system.nv);
  weight.head(system.nx).setConstant(1.0 / (1.0 + largest(y.head(system.nx))));
  weight.tail(system.nv).setConstant(1.0 / (size_v == 0.0 ? 1.0 : size_v));
  return TO_ROUNDING;
}

// Changes of v that belong to changes of the position, if Newton iterates down to rounding, else 0.
inline double per_position(double c, double tol) { return tol <= TO_ROUNDING ? 1.0 / std::abs(c) : 0.0; }

// The sum of all increments after one of a given size, if each is `rate` times the previous one.
inline double to_come(double size, double rate) { return rate < 1.0 ? size * rate / (1.0 - rate) : INF; }

// The increments, relative to the velocities, that count as noise if Newton stagnates or at its last iteration.
inline double tolerated(double rate, int iteration, double most) {
  if (iteration > 1 && rate > STAGNANT) return STAGNATED;
  return iteration == most ? LAST : 0.0;
}

// Whether increments, of the velocity by the dynamics and of the position by the constraint, are rounding errors.
inline bool is_noise(double step, double moved, double scale, double reach, double noise, double per_position, bool closed) {
  const double least = per_position * std::max(UNMOVED * EPS * reach, closed ? moved : 0.0);
  return step <= std::max(noise * (scale + step), least) && moved <= (closed ? HALF : 1e4 * EPS) * reach;
}

inline double rounding_gap(const Vec &p, const Mat &W) { return GAP * (1.0 + largest(p)) * (1.0 + largest(W)); }

// How much rounding may change v: a worst-case bound from norms, and an estimate along the constraint rows.
struct VelocityNoise {
  double worst, likely;
};

inline VelocityNoise velocity_rounding(System &system, KKT &kkt, double t, const Vec &p, const Vec &v) {
  const int nv = system.nv, nc = system.nc;
  const double speed = largest(v), reach = 1.0 + largest(p);
  if (!nc) return {EPS * speed, SURE * EPS * speed};
  system.constraint(t, p, v);
  const Vec here = system.rho;
  Mat solved = Mat::Zero(nv + nc, nc);
  solved.bottomRows(nc).setIdentity();
  system.mass_matrix(t, p, v, kkt.A());
  if (!kkt.solve_new(system.W, system.G_transposed(), 1.0, solved)) return {INF, INF};
  const auto closing = solved.topRows(nv);
  int farthest;
  const double s = closing.cwiseAbs().rowwise().sum().maxCoeff(&farthest);
  const double turn = system.W.cwiseAbs().rowwise().sum().maxCoeff();
  const Vec moved = closing * closing.row(farthest).cwiseSign().transpose();
  const double share = TURNED * reach / largest(moved);
  Vec there;
  system.integrate(p, system.rate(t, p, v + share * moved) - system.rate(t, p, v), there);
  system.constraint(t, there, v);
  const double turned = reach * largest(closing * (system.rho - here)) / share;
  return {EPS * speed * (1.0 + reach * s * s * turn), SURE * EPS * (speed + turned)};
}

// Whether the error of a step is rounding of the velocities.
class RoundingTest {
public:
  void restart() { noise_ = 0.0; }

  template <class Explained, class Noise>
  bool passes(double error, bool shows, double speed, const Explained &explained, const Noise &noise) {
    const double most = explained(HALF * speed);
    if (error > most || (!shows && (error <= 1.0 || SURE * error > most))) return false;
    if (shows && error <= explained(noise_)) return true;
    const VelocityNoise found = noise();
    if (found.worst >= BESIDE * speed && SURE * error <= explained(std::min(found.worst, HALF * speed))) return true;
    noise_ = std::max(noise_, std::min(found.likely, speed)); // infinite noise would never fade
    return shows && error <= explained(noise_);
  }

  void accepted() { noise_ *= 0.5; }

private:
  double noise_ = 0.0; // in v of the last steps; the noise of a step fades from later differences
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
