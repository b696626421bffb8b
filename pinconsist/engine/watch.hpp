// The functions whose zeros end a mode of contact: gaps, forces and speeds of sliding.
#pragma once

#include "contact_laws.hpp"
#include "mechanism.hpp"

#include <algorithm>
#include <optional>

namespace pinconsist {

class ContactWatch {
public:
  // Of all rows of the contacts, in their order.
  explicit ContactWatch(MechanismSystem &rows) : rows_(rows) {}

  // The gap of a row, above `level`, positive.
  void add_gap(int row, double level) { watched_.push_back({Kind::gap, row, {}, level, {}}); }
  // A multiplier in use, of a force that may only push.
  void add_push(int place) { watched_.push_back({Kind::push, place, {}, 0.0, {}}); }
  // friction · |U λ|, with λ of these places, less |λ| of `beside`: the cone; or `friction` less |λ|, if there are no places.
  void add_cone(std::vector<int> places, Mat U, std::vector<int> beside, double friction) {
    watched_.push_back({Kind::cone, 0, std::move(beside), friction, {}, std::move(places), std::move(U)});
  }
  // Where forces of dependent rows, those of all rows being `forces` · λ, cannot be distributed so that they obey their laws, or
  // rows that are not used do not hold, and ``agree(t, p, v)`` says that the accelerations call for other modes, this falls from
  // 1 to −1. The owner keeps it alive.
  void add_laws(ContactLaws laws, Mat forces, nb::handle agree) {
    laws_.emplace(Dependent{std::move(laws), std::move(forces), agree});
    watched_.push_back({Kind::laws, 0, {}, 0.0, {}});
  }
  // The speed of sliding of rows from `row` on, along `direction`; of two rows, along their direction at the start of each
  // step, if they slide faster than `still`.
  void add_speed(int row, const Vec &direction, double still) { watched_.push_back({Kind::speed, row, {}, still, direction}); }

  size_t size() const { return watched_.size(); }
  bool is_gap(size_t i) const { return watched_[i].kind == Kind::gap; }
  bool with_multipliers() const {
    return std::any_of(watched_.begin(), watched_.end(), [](const Watched &of) { return of.kind < Kind::gap; });
  }

  double value(size_t i, double t, const Vec &p, const Vec &v, const Vec &lam) {
    const Watched &of = watched_[i];
    if (of.kind == Kind::push) return lam[of.row];
    if (of.kind == Kind::laws) return obeyed(t, p, v, lam) ? 1.0 : -1.0;
    if (of.kind == Kind::cone) {
      double square = 0.0;
      for (int place : of.beside) square += lam[place] * lam[place];
      return of.number * (of.places.empty() ? 1.0 : load(of, lam)) - std::sqrt(square);
    }
    evaluate(t, p, v);
    if (of.kind == Kind::gap) return now_.gap[of.row] - of.number;
    return of.direction.dot(now_.rate.segment(of.row, of.direction.size()));
  }

  // A step begins where the last look was.
  void begin_step() {
    for (Watched &of : watched_) {
      if (of.kind != Kind::speed || of.direction.size() < 2 || !now_.rate.size()) continue;
      const auto slip = now_.rate.segment(of.row, of.direction.size());
      const double speed = slip.norm();
      if (speed > of.number) of.direction = slip / speed;
    }
  }

  // The next look is at a later time than the last one.
  void advance() { before_ = now_; }
  void back() { now_ = before_; }

  // A time between the last two looks at which some gap may be negative although it is not at either; NaN if there is none.
  double doubtful() const {
    if (!before_.gap.size() || !now_.gap.size()) return NOT_A_NUMBER;
    const double h = now_.t - before_.t;
    double lowest = 0.0, when = NOT_A_NUMBER;
    for (const Watched &of : watched_) {
      if (of.kind != Kind::gap) continue;
      const double g0 = before_.gap[of.row] - of.number, g1 = now_.gap[of.row] - of.number;
      const double d0 = h * before_.rate[of.row], d1 = h * now_.rate[of.row];
      const double a = 2.0 * (g0 - g1) + d0 + d1, b = 3.0 * (g1 - g0) - 2.0 * d0 - d1, root = b * b - 3.0 * a * d0;
      if (!(root > 0.0) || b + std::sqrt(root) == 0.0) continue;
      const double s = -d0 / (b + std::sqrt(root)); // where the cubic has its minimum
      if (!(s > EDGE && s < 1.0 - EDGE)) continue;
      const double least = g0 + s * (d0 + s * (b + s * a));
      const double part = (least - NEAR_GAP * std::min(g0, g1)) / (std::abs(g0) + std::abs(g1) + 1e-300);
      if (part < lowest) {
        lowest = part;
        when = before_.t + s * h;
      }
    }
    return when;
  }

private:
  enum class Kind { push, cone, laws, gap, speed }; // the first three use λ
  struct Watched {
    Kind kind;
    int row; // of the contacts' rows; of push and cone, a place in λ
    std::vector<int> beside;
    double number;
    Vec direction;
    std::vector<int> places = {};
    Mat U = {};
  };
  struct Seen {
    double t = NOT_A_NUMBER;
    Vec p, v, gap, rate;
  };

  struct Dependent {
    ContactLaws laws;
    Mat forces;
    nb::handle agree;
  };

  static double load(const Watched &of, const Vec &lam) {
    const Vec all = of.U * lam(of.places);
    return all.size() > 1 ? all.norm() : all[0]; // a normal force has a sign
  }

  bool obeyed(double t, const Vec &p, const Vec &v, const Vec &lam) {
    Vec forces = laws_->forces * lam;
    rows_.constraint(t, p, v);
    laws_->laws.share(rows_.W, forces);
    const bool right = laws_->laws.obey(forces) && laws_->laws.held(rows_.rho, HELD * (1.0 + largest(v)));
    return right || nb::cast<bool>(laws_->agree(t, array(p), array(v)));
  }

  void evaluate(double t, const Vec &p, const Vec &v) {
    if (now_.t == t && now_.p.size() && now_.p == p && now_.v == v) return;
    rows_.constraint(t, p, v);
    now_ = {t, p, v, rows_.phi, rows_.rho};
  }

  static constexpr double HELD = 1e-8;    // rate of a row, relative to velocities, of what is at rest, between the ends of steps
  static constexpr double EDGE = 1e-6;    // of the way between two looks: a minimum there is seen by the looks
  static constexpr double NEAR_GAP = 0.2; // of the gaps at the looks: a lower minimum is looked at

  MechanismSystem &rows_;
  std::vector<Watched> watched_;
  std::optional<Dependent> laws_;
  Seen before_, now_;
};

} // namespace pinconsist
