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

// The angle about the z axes of two anchors, which a hinge keeps aligned, less `at`: of a pin that sticks.
class PinRow : public BetweenAnchors {
public:
  PinRow(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, double at)
      : BetweenAnchors(model, joint1, place1, joint2, place2), at_(at) {}

  void evaluate(const Data &data, double, const Vec &, int at, Vec &phi, Mat &J) const override {
    const Matrix3d turn = axes(data, joint1_, place1_);
    const Vector3d x = turn.transpose() * axes(data, joint2_, place2_).col(0);
    phi[at] = nearest(std::atan2(x[1], x[0]) - at_, 2.0 * M_PI);
    for (const auto &column : columns_) J(at, column.index) = column.sign * turn.col(2).dot(spin(data, column.index));
  }
  void add_bias(const Data &data, double, const Vec &, const Vec &, int at, Vec &bias) const override {
    const Moving m1(data, joint1_, place1_), m2(data, joint2_, place2_);
    const Vector3d axis = axes(data, joint1_, place1_).col(2);
    bias[at] += axis.dot(m2.b - m1.b) + m1.w.cross(axis).dot(m2.w - m1.w);
  }
  bool add_gradients(const Data &data, const Vec &, const Vec &v, const Vec &lam, int at, Mat &F, Mat &H) const override {
    const Vector3d none = Vector3d::Zero(), axis = axes(data, joint1_, place1_).col(2), moment = lam[at] * axis;
    const Vector3d rate = H.size() ? Vector3d(relative_twist(data, columns_, v).tail<3>()) : none;
    const auto turned = [&](const Signed &k) { return k.sign < 0.0 ? spin(data, k.index) : none; };
    differentiate(
        data, columns_, v, wrench_of(none, none, moment),
        [&](const Signed &k) { return wrench_of(none, none, turned(k).cross(moment)); },
        [&](const Signed &k, const Six &change) { H(at, k.index) += axis.dot(change.tail<3>() - turned(k).cross(rate)); }, F, H.size());
    return true;
  }
  void add_wrench(const Data &data, const Vec &lam, const Vector3d &, Vector3d &, Vector3d &moment) const override {
    moment += lam[0] * axes(data, joint1_, place1_).col(2);
  }
  int size() const override { return 1; }

private:
  double at_;
};

// The friction of a pin that turns, which has no row of its own. The load R = U λ of the rows of its hinge at these places
// adds the moment −c |R| about the axis, in which c has the sense of turning: G has Jᵀ − c Dᵀ R̂ᵀ U with the row D of turning,
// and R̂ of the multipliers taken last. As |R| = R̂·R up to the square of an error of R̂, it is soon exact.
class TurningPin : public PinRow {
public:
  TurningPin(const Model &model, int joint1, const SE3 &place1, int joint2, const SE3 &place2, std::vector<int> places, Mat U, double c)
      : PinRow(model, joint1, place1, joint2, place2, 0.0), places_(std::move(places)), U_(std::move(U)), c_(c), nv_(model.nv) {
    pull_.setZero(U_.cols());
  }

  void evaluate(const Data &data, double t, const Vec &p, int, Vec &, Mat &) const override {
    angle_.setZero(1);
    turning_.setZero(1, nv_);
    PinRow::evaluate(data, t, p, 0, angle_, turning_);
  }
  void add_bias(const Data &, double, const Vec &, const Vec &, int, Vec &) const override {}
  bool add_gradients(const Data &data, const Vec &p, const Vec &v, const Vec &lam, int, Mat &F, Mat &) const override {
    Mat none;
    const Vec moment = Vec::Constant(1, -c_ * load(lam).norm());
    return PinRow::add_gradients(data, p, v, moment, 0, F, none);
  }
  void add_wrench(const Data &, const Vec &, const Vector3d &, Vector3d &, Vector3d &) const override {}
  int size() const override { return 0; }

  bool slides() const override { return true; }
  bool reacts() const override { return true; }
  void react(const Vec &lam) override {
    const Vec R = load(lam);
    if (R.squaredNorm() > 0.0) pull_ = U_.transpose() * R.normalized();
  }
  // Of the row evaluated last.
  void add_friction(const Vec &, int, Mat &Gt) const override {
    for (size_t k = 0; k < places_.size(); ++k) Gt.row(places_[k]) -= c_ * pull_[k] * turning_;
  }

private:
  Vec load(const Vec &lam) const { return U_ * lam(places_); }

  std::vector<int> places_;
  Mat U_;
  double c_;
  int nv_;
  Vec pull_;
  mutable Vec angle_;
  mutable Mat turning_;
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
