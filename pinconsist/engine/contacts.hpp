// Rows of what touches: stops of joints, rows of the other sign, contacts that slide.
#pragma once

#include "rows.hpp"

namespace pinconsist {

// sign (q_joint − at), up to whole periods if the last is not 0
class LimitRow : public Rows {
public:
  LimitRow(Coordinate joint, double sign, double at, double period) : joint_(joint), sign_(sign), at_(at), period_(period) {}

  void evaluate(const Data &, double, const Vec &p, int at, Vec &phi, Mat &J) const override {
    phi[at] = sign_ * nearest(joint_.value(p) - at_, period_);
    J(at, joint_.column) = sign_;
  }
  void add_bias(const Data &, double, const Vec &, const Vec &, int, Vec &) const override {}
  bool add_gradients(const Data &, const Vec &, const Vec &, const Vec &, int, Mat &, Mat &) const override { return true; }
  int size() const override { return 1; }

private:
  Coordinate joint_;
  double sign_, at_, period_;
};

// (L² − |d|²) / (2 L): the gap of a rope.
class RopeRow : public DistanceRow {
public:
  using DistanceRow::DistanceRow;

  void evaluate(const Data &data, double t, const Vec &p, int at, Vec &phi, Mat &J) const override {
    DistanceRow::evaluate(data, t, p, at, phi, J);
    phi[at] = -phi[at];
    J.row(at) = -J.row(at);
  }
  bool add_to(LaneTree &, int) const override { return false; } // not with the sign of a distance
  void add_bias(const Data &data, double t, const Vec &p, const Vec &v, int at, Vec &bias) const override {
    Vec own = Vec::Zero(1);
    DistanceRow::add_bias(data, t, p, v, 0, own);
    bias[at] -= own[0];
  }
  bool add_gradients(const Data &data, const Vec &p, const Vec &v, const Vec &lam, int at, Mat &F, Mat &H) const override {
    DistanceRow::add_gradients(data, p, v, -lam, at, F, H);
    if (H.size()) H.row(at) = -H.row(at);
    return true;
  }
  void add_wrench(const Data &data, const Vec &lam, const Vector3d &x, Vector3d &force, Vector3d &moment) const override {
    DistanceRow::add_wrench(data, -lam, x, force, moment);
  }
};

// The normal row of a contact that slides: W has n, and G has n − μ Tᵀd with the direction d of sliding. If there are two
// tangents, d = T v / |T v|. It has the sense that it had at the start of the step where it is reversed within one, so that
// the force stays smooth where sliding ends; at less than `still` it is the one given.
class SlidingRow : public Rows {
public:
  SlidingRow(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, const Mat &matrix, double friction,
             const Vec &direction, double still)
      : normal_(model, joint1, place1, joint2, place2, matrix.topRows(1)), all_(model, joint1, place1, joint2, place2, matrix),
        friction_(friction), still_(still), direction_(direction), n_(static_cast<int>(matrix.rows())), nv_(model.nv) {}

  void evaluate(const Data &data, double t, const Vec &p, int at, Vec &phi, Mat &J) const override {
    own_phi_.setZero(n_);
    own_.setZero(n_, nv_);
    all_.evaluate(data, t, p, 0, own_phi_, own_);
    phi[at] = own_phi_[0];
    J.row(at) = own_.row(0);
  }
  void add_bias(const Data &data, double t, const Vec &p, const Vec &v, int at, Vec &bias) const override {
    normal_.add_bias(data, t, p, v, at, bias);
  }
  bool add_gradients(const Data &data, const Vec &p, const Vec &v, const Vec &lam, int at, Mat &F, Mat &H) const override {
    Mat unused;
    Vec own(n_), plain = lam;
    own << 0.0, -friction_ * lam[at] * towards(v);
    normal_.add_gradients(data, p, v, plain, at, F, H);
    return all_.add_gradients(data, p, v, own, 0, F, unused);
  }
  int size() const override { return 1; }

  // Of the rows evaluated last.
  void add_friction(const Vec &v, int at, Mat &Gt) const override {
    Gt.row(at) -= friction_ * towards(v).transpose() * own_.bottomRows(n_ - 1);
  }
  // Add −∂(G λ)/∂v.
  void add_turning(const Vec &v, const Vec &lam, int at, Mat &D) const override {
    if (n_ < 3) return;
    const Vec slip = own_.bottomRows(n_ - 1) * v;
    const double speed = slip.norm();
    if (!(speed > still_)) return;
    const double way = sense(slip, speed);
    const Vec d = slip / speed;
    const Mat across = Mat::Identity(n_ - 1, n_ - 1) - d * d.transpose();
    D += way * friction_ * lam[at] / speed * own_.bottomRows(n_ - 1).transpose() * across * own_.bottomRows(n_ - 1);
  }
  void step_ended(const Vec &v) override {
    if (n_ == 3) direction_ = towards(v);
  }
  void aim(const Vec &v) override {
    if (n_ < 3) return;
    const Vec slip = own_.bottomRows(n_ - 1) * v;
    const double speed = slip.norm();
    if (speed > still_) direction_ = slip / speed;
  }
  bool slides() const override { return true; }

private:
  Vec towards(const Vec &v) const {
    if (n_ < 3) return direction_;
    const Vec slip = own_.bottomRows(n_ - 1) * v;
    const double speed = slip.norm();
    if (!(speed > still_)) return direction_;
    return sense(slip, speed) / speed * slip;
  }

  // Whether sliding is about reversed since the start of the step; before, a mode ends where it has turned by a right angle.
  double sense(const Vec &slip, double speed) const { return slip.dot(direction_) < -0.5 * speed ? -1.0 : 1.0; }

  AnchoredRows normal_, all_;
  double friction_, still_;
  Vec direction_;
  int n_, nv_;
  mutable Vec own_phi_;
  mutable Mat own_;
};

// C Φ of the rows Φ of several parts, whose multipliers are then Cᵀ λ: of gaps that depend on each other.
class CombinedRows : public Rows {
public:
  CombinedRows(std::vector<std::unique_ptr<Rows>> parts, Mat combination)
      : parts_(std::move(parts)), C_(std::move(combination)), n_(static_cast<int>(C_.cols())) {}

  void evaluate(const Data &data, double t, const Vec &p, int at, Vec &phi, Mat &J) const override {
    phi_.setZero(n_);
    J_.setZero(n_, J.cols());
    for_each([&](const Rows &part, int k) { part.evaluate(data, t, p, k, phi_, J_); });
    phi.segment(at, size()) = C_ * phi_;
    J.middleRows(at, size()) = C_ * J_;
  }
  void add_rate(double t, const Vec &p, int at, Vec &rate) const override {
    phi_.setZero(n_);
    for_each([&](const Rows &part, int k) { part.add_rate(t, p, k, phi_); });
    rate.segment(at, size()) += C_ * phi_;
  }
  void add_bias(const Data &data, double t, const Vec &p, const Vec &v, int at, Vec &bias) const override {
    phi_.setZero(n_);
    for_each([&](const Rows &part, int k) { part.add_bias(data, t, p, v, k, phi_); });
    bias.segment(at, size()) += C_ * phi_;
  }
  void add_wrench(const Data &data, const Vec &lam, const Vector3d &x, Vector3d &force, Vector3d &moment) const override {
    const Vec own = C_.transpose() * lam;
    for_each([&](const Rows &part, int k) { part.add_wrench(data, own.segment(k, part.size()), x, force, moment); });
  }
  bool add_gradients(const Data &data, const Vec &p, const Vec &v, const Vec &lam, int at, Mat &F, Mat &H) const override {
    const Vec own = C_.transpose() * lam.segment(at, size());
    Mat rates = Mat::Zero(H.size() ? n_ : 0, H.cols());
    bool known = true;
    for_each([&](const Rows &part, int k) { known = known && part.add_gradients(data, p, v, own, k, F, rates); });
    if (H.size()) H.middleRows(at, size()) += C_ * rates;
    return known;
  }
  int size() const override { return static_cast<int>(C_.rows()); }
  bool calls_python() const override { return any([](const Rows &part) { return part.calls_python(); }); }

  bool slides() const override { return any([](const Rows &part) { return part.slides(); }); }
  void add_friction(const Vec &v, int at, Mat &Gt) const override {
    J_.setZero(n_, Gt.cols());
    for_each([&](const Rows &part, int k) { part.add_friction(v, k, J_); });
    Gt.middleRows(at, size()) += C_ * J_;
  }
  void add_turning(const Vec &v, const Vec &lam, int at, Mat &D) const override {
    const Vec own = C_.transpose() * lam.segment(at, size());
    for_each([&](const Rows &part, int k) { part.add_turning(v, own, k, D); });
  }
  void step_ended(const Vec &v) override {
    for (auto &part : parts_) part->step_ended(v);
  }
  void aim(const Vec &v) override {
    for (auto &part : parts_) part->aim(v);
  }

private:
  template <class F> void for_each(const F &function) const {
    int k = 0;
    for (const auto &part : parts_) {
      function(*part, k);
      k += part->size();
    }
  }
  template <class F> bool any(const F &function) const {
    return std::any_of(parts_.begin(), parts_.end(), [&](const auto &part) { return function(*part); });
  }

  std::vector<std::unique_ptr<Rows>> parts_;
  Mat C_;
  int n_;
  mutable Vec phi_;
  mutable Mat J_;
};

} // namespace pinconsist
