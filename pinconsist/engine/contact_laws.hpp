// The laws of contacts that rest or stick: forces push, and friction is below its limit.
#pragma once

#include "complementarity.hpp"

#include <algorithm>

namespace pinconsist {

class ContactLaws {
public:
  // An element's first row, whether it has a gap, its tangents, and its static friction; whether its gap is closed and does not
  // slide, so that dependent rows may share its force, and whether it sticks.
  struct Element {
    int first;
    bool pushes;
    int tangents;
    double friction;
    bool rests, sticks;
  };

  explicit ContactLaws(std::vector<Element> elements) : elements_(std::move(elements)) {
    for (const Element &of : elements_) {
      const int at = static_cast<int>(rows_.size());
      if (of.rests && of.pushes) add({at, 1, true, 0.0, 0.0, -1}, of.first);
      if (!of.sticks) continue;
      const int own = static_cast<int>(rows_.size());
      const Law law = of.pushes ? Law{own, of.tangents, false, 0.0, of.friction, at} : Law{own, of.tangents, false, of.friction, 0.0, -1};
      add(law, of.first + of.pushes);
    }
  }

  // Whether the forces of all rows obey their laws.
  bool obey(const Vec &forces) const {
    const double small = SHARED * (forces.size() ? forces.cwiseAbs().maxCoeff() : 0.0);
    return std::all_of(elements_.begin(), elements_.end(), [&](const Element &of) {
      const double push = of.pushes ? forces[of.first] : 1.0;
      return !(of.pushes && push < -small) && forces.segment(of.first + of.pushes, of.tangents).norm() <= of.friction * push + small;
    });
  }

  // Whether what rests and sticks does so, with these rates of all rows: a drive may move what rows that are not used hold.
  bool held(const Vec &rates, double most) const {
    return std::all_of(elements_.begin(), elements_.end(), [&](const Element &of) {
      const bool gap = !(of.rests && of.pushes) || std::abs(rates[of.first]) <= most;
      return gap && (!of.sticks || rates.segment(of.first + of.pushes, of.tangents).cwiseAbs().maxCoeff() <= most);
    });
  }

  // Distribute forces among dependent rows of the matrix R of all rows, so that each obeys its law, if that is possible.
  // What the last distribution has added is tried first.
  void share(const Mat &R, Vec &forces) {
    if (obey(forces)) return;
    const Mat own = R(rows_, Eigen::all);
    const Vec given = forces(rows_), total = own.transpose() * given;
    const double small = SHARED * total.cwiseAbs().maxCoeff();
    const auto put = [&](const Vec &shares) {
      if ((own.transpose() * shares - total).cwiseAbs().maxCoeff() > small) return false;
      forces(rows_) = shares;
      return true;
    };
    if (added_.size() && put(given + added_)) {
      if (obey(forces)) return;
      forces(rows_) = given;
    }
    const Vec shares = solution(own * own.transpose(), -own * total, laws_, true).z;
    if (put(shares)) added_ = shares - given;
  }

private:
  void add(const Law &law, int first) {
    laws_.push_back(law);
    for (int i = 0; i < law.size; ++i) rows_.push_back(first + i);
  }

  static constexpr double SHARED = 1e-9; // relative error of forces that are distributed

  std::vector<Element> elements_;
  std::vector<Law> laws_;
  std::vector<int> rows_; // of the laws
  Vec added_;
};

} // namespace pinconsist
