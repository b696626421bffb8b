// The part of a projection of velocities that is along stiff forces.
//
// The projection moves the velocities as an impulse does. Along stiff forces, of which the stages are free, this is an
// error of the order of the stages, which lasts for a moment only but is felt by the multipliers. With
// A = M + c D + c² K, c = h/STIFF, it is (A⁻¹ (A - M))² Δv, restricted to W x = 0.
#pragma once

#include "kkt.hpp"
#include "system.hpp"

#include <optional>

namespace pinconsist {

class StiffForces {
public:
  explicit StiffForces(const System &system)
      : system_(system), effect_(system.nv + system.nc, 1) {}

  // For a step of this size.
  void set(const Mat &D, const Mat &K, double step) {
    const double c = step / STIFF;
    stiff_ = c * D + c * c * K;
  }

  // What these forces do to the velocities after a change by `moved`, with the factors of M.
  auto effect(const KKT &kkt, const Vec &moved) {
    act(moved);
    kkt.solve(effect_, 1.0);
    return effect_.col(0).head(system_.nv);
  }

  // Take the part of `moved` that they hold back out of `v`.
  void take_back(const Mat &M, Vec moved, Vec &v) {
    if (!within_) within_.emplace(system_.nv, system_.nc); // most scenes need none
    within_->A() = M + stiff_;
    act(moved);
    if (!within_->solve_new(system_.W, system_.G_transposed(), 1.0, effect_)) return;
    moved = effect_.col(0).head(system_.nv);
    v -= effect(*within_, moved);
  }

private:
  void act(const Vec &moved) {
    effect_.col(0).head(system_.nv).noalias() = stiff_.lazyProduct(moved);
    effect_.col(0).tail(system_.nc).setZero();
  }

  const System &system_;
  std::optional<KKT> within_;
  Mat stiff_, effect_;
};

} // namespace pinconsist
