// dae/start.py: the first history of a run of variable step.
#pragma once

#include "control.hpp"
#include "index1.hpp"

namespace pinconsist {

// Equidistant states, oldest first, and the step between them.
struct History {
  double h = 0.0;
  std::vector<double> t;
  std::vector<Vec> p, v, lam;
};

// The states with which a run begins at the highest order of the control; `turns` as in the stepper.
class Start {
public:
  Start(System &system, Projection &index1, const Control &control, const Mat &turns)
      : system_(system), index1_(index1), control_(control), turns_(turns), k_(control.max_order) {}

  // False if the index-1 equations cannot be integrated, or a state cannot be projected onto the constraints. If the first
  // step is 0, it is chosen here.
  bool history(double t0, const Vec &p0, const Vec &v0, double t_end, double first_step, History &out) {
    const int nx = system_.nx;
    const double speed = bdf::fastest_turn(turns_, system_.rate(t0, p0, v0));
    const double rtol = START_SHARE * control_.rtol.minCoeff(), atol = START_SHARE * control_.atol.minCoeff();
    Vec y0 = Vec::Zero(nx + system_.nv);
    if (system_.vector_like) y0.head(nx) = p0;
    y0.tail(system_.nv) = v0;
    OneStep run(index1_, p0, t0, y0, t_end, std::max(rtol, 1e-13), std::max(atol, 1e-14),
                speed != 0.0 ? START_TURN / speed : INF, true);
    double longest = 0.0;
    for (int i = 0; i < static_cast<int>(START_STEPS); ++i) { // the first step is cautious: continue while steps grow
      if (*run.step()) return false;
      const bool grows = run.step_size > START_GROWTH * longest;
      longest = run.step_size;
      if (run.finished || !grows || turned(run.y.transpose()) > START_TURN) break;
    }
    const double shortest = START_APART * std::max(shortest_step(t0), shortest_step(t_end));
    while (!run.finished && std::abs(run.t - t0) < (k_ + 1) * shortest)
      if (*run.step()) return false;
    double reach = (run.t - t0) / (k_ + 1);
    while (turned(rows(run, t0, reach).row(k_ + 1)) > START_TURN) reach *= START_SHORTER;
    double h = first_step != 0.0 ? std::copysign(std::min(std::abs(first_step), std::abs(reach)), reach) : reach;
    for (int i = 0; i < static_cast<int>(START_TRIES) && first_step == 0.0; ++i) {
      const double error = error_of(rows(run, t0, h));
      if (error <= START_ERROR) break;
      h *= std::max(START_LEAST, SAFETY * std::pow(START_AIM / error, 1.0 / (k_ + 1)));
    }
    out.h = std::copysign(std::max(std::min(std::abs(h), control_.max_step), shortest), h);
    if ((k_ + 1) * std::abs(out.h) < std::abs(t_end - t0)) // else it may lead to the end exactly
      out.h = representable(t0, out.h);
    const bool full = std::abs(reach) >= shortest;
    if (!full) out.h = t_end - t0;
    return states(full ? rows(run, t0, out.h) : run.sample((Vec(2) << t0, t_end).finished()), t0, p0, v0, out);
  }

private:
  Table rows(const OneStep &run, double t0, double h) const {
    return run.sample(Vec::LinSpaced(k_ + 2, 0.0, k_ + 1.0) * h + Vec::Constant(k_ + 2, t0));
  }

  template <class Row> double turned(const Row &row) const {
    return bdf::fastest_turn(turns_, row.head(system_.nx).transpose());
  }

  // The local error from equidistant rows [ξ | v], oldest first.
  double error_of(const Table &rows) const {
    const Vec size = rows.cwiseAbs().colwise().maxCoeff().transpose();
    const Vec weight = (control_.atol + control_.rtol.cwiseProduct(size)).cwiseInverse();
    const Vec last = (bdf::differences(k_ + 1).row(k_ + 1) * rows.colwise().reverse()).transpose();
    return control_.error_in(system_, last, k_, weight);
  }

  bool states(const Table &rows, double t0, const Vec &p0, const Vec &v0, History &out) {
    const int nx = system_.nx;
    Vec p = p0, v = v0, a, lam;
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      const double t = t0 + i * out.h;
      if (i) {
        if (system_.vector_like) p = rows.row(i).head(nx).transpose();
        else system_.integrate(p0, rows.row(i).head(nx).transpose(), p);
        const State closed = index1_.project(t, p, rows.row(i).tail(system_.nv).transpose());
        if (*closed.failure) return false;
        p = closed.p;
        v = closed.v;
      }
      if (!index1_.acceleration(t, p, v, a, lam) || !a.allFinite() || !lam.allFinite()) return false;
      out.t.push_back(t);
      out.p.push_back(p);
      out.v.push_back(v);
      out.lam.push_back(lam);
    }
    return true;
  }

  System &system_;
  Projection &index1_;
  const Control &control_;
  const Mat &turns_;
  const int k_;
};

} // namespace pinconsist
