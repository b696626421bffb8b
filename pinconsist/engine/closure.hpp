// Closed configurations along a path of a few coordinates, within one assembly mode.
#pragma once

#include "kkt.hpp"
#include "mechanism.hpp"

#include <array>

namespace pinconsist {

class ClosureFollower {
  static constexpr double OUTWARD = 1e-4;
  static constexpr int TRIES = 400;

public:
  // `numbers`: LONGEST_MOTION, SHORTEST, MISS, SHRINK, AIM, LEAST, FURTHER, ENOUGH, CORRECTIONS.
  ClosureFollower(MechanismSystem &system, std::vector<int> coordinates, const Vec &sizes, const std::array<double, 9> &numbers)
      : system_(system), y_(std::move(coordinates)), sizes_(sizes), numbers_(numbers), zero_(Vec::Zero(system.nv)),
        here_(system.nc), there_(system.nc) {
    for (int i = 0; i < system.nv; ++i)
      if (std::find(y_.begin(), y_.end(), i) == y_.end()) p_.push_back(i);
    if (static_cast<int>(p_.size()) != system.nc) throw nb::value_error("coordinates and rows do not add up");
  }

  // The configuration reached, and the share of the way covered.
  std::pair<Vec, double> follow(Vec q, const Vec &way) {
    const auto [longest, shortest, miss, shrink, aim, least, further, enough, most] = numbers_;
    double length = 0.0, share = 0.0, part = 1.0;
    for (size_t i = 0; i < y_.size(); ++i) length = std::max(length, std::abs(way[i]) / sizes_[y_[i]]);
    const bool regular = (q.size() == last_q_.size() && q == last_q_) || factorise(q, here_, J_y_);
    last_q_.resize(0);
    for (int tries = 0; regular && share < 1.0 && tries < TRIES; ++tries) {
      const bool is_short = part < 1.0 && part * length < shortest; // made short by rejections, not by a short path or remainder
      const bool last = part >= 1.0 - share;
      part = std::min(part, 1.0 - share);
      double longer = 0.5;
      if (step(q, part * way, is_short, longer)) share = last ? 1.0 : share + part;
      else if (part * length < OUTWARD * shortest) break;
      part *= longer;
    }
    if (regular) last_q_ = q; // its factors are kept
    return {q, share};
  }

private:
  // Φ and J at a configuration, factors of J_p, and J_y; false if it is singular.
  bool factorise(const Vec &q, LU &lu, Mat &J_y) {
    system_.constraint(0.0, q, zero_);
    B_ = system_.W(Eigen::all, p_);
    J_y = system_.W(Eigen::all, y_);
    return B_.allFinite() && lu.factorise(B_);
  }

  // q ⊕ δq, and the size of δq.
  double move(Vec &q, const Vec &of_p) {
    change_(p_) = of_p;
    system_.integrate(q, change_, moved_);
    std::swap(q, moved_);
    const double size = change_.cwiseQuotient(sizes_).cwiseAbs().maxCoeff();
    return std::isfinite(change_.sum()) ? size : INFINITY;
  }

  // `longer`: factor for the next step. Steps that `is_short` marks may only lead away from singular positions.
  bool step(Vec &q, const Vec &way, bool is_short, double &longer) {
    const auto [longest, shortest, miss, shrink, aim, least, further, enough, most] = numbers_;
    change_ = zero_;
    change_(y_) = way;
    Vec x = q, correction = -(J_y_ * way);
    here_.substitute(correction.data(), 1);
    const double size = move(x, correction);
    if (!(size <= longest)) {
      longer = std::max(least, longest / size);
      return false;
    }
    double last = 0.0;
    change_ = zero_;
    for (int i = 0; i < most; ++i) {
      if (!factorise(x, there_, next_J_y_)) break;
      correction = -system_.phi;
      there_.substitute(correction.data(), 1);
      const double corrected = move(x, correction);
      if (!i) longer = std::clamp(aim * miss * size / std::max(corrected, enough), least, further);
      if (!(corrected <= enough || corrected <= (i ? shrink * last : miss * size))) {
        longer = std::min(longer, 0.5);
        return false;
      }
      last = corrected;
      if (corrected > enough) continue;
      const auto [before, odd_before] = here_.determinant();
      const auto [after, odd] = there_.determinant();
      longer = odd == odd_before ? std::max(longer, 1.0) : 0.5;
      if (odd != odd_before || (is_short && after < before)) return false;
      q = x;
      std::swap(here_, there_);
      std::swap(J_y_, next_J_y_);
      return true;
    }
    longer = 0.5;
    return false;
  }

  MechanismSystem &system_;
  std::vector<int> y_, p_;
  const Vec sizes_;
  const std::array<double, 9> numbers_;
  const Vec zero_;
  LU here_, there_;
  Mat B_, J_y_, next_J_y_;
  Vec change_, moved_, last_q_; // the configuration of here_, or empty
};

} // namespace pinconsist
