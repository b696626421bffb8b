// The only file that knows Pinocchio's models and algorithms.
#include "tree.hpp"

#include <pinocchio/multibody.hpp>

#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <stdexcept>

namespace pinconsist {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Every joint of Pinocchio; those along a coordinate axis are special cases of these.
template <class Scalar_, int Options_> struct Joints {
  typedef Scalar_ Scalar;
  static constexpr int Options = Options_;

  typedef pinocchio::JointModelCompositeTpl<Scalar, Options, Joints> JointModelComposite;
  typedef pinocchio::JointDataCompositeTpl<Scalar, Options, Joints> JointDataComposite;
  typedef boost::variant<
      pinocchio::JointModelRevoluteUnalignedTpl<Scalar, Options>,
      pinocchio::JointModelRevoluteUnboundedUnalignedTpl<Scalar, Options>,
      pinocchio::JointModelPrismaticUnalignedTpl<Scalar, Options>,
      pinocchio::JointModelHelicalUnalignedTpl<Scalar, Options>,
      pinocchio::JointModelFreeFlyerTpl<Scalar, Options>,
      pinocchio::JointModelPlanarTpl<Scalar, Options>,
      pinocchio::JointModelSphericalTpl<Scalar, Options>,
      pinocchio::JointModelSphericalZYXTpl<Scalar, Options>,
      pinocchio::JointModelTranslationTpl<Scalar, Options>,
      pinocchio::JointModelUniversalTpl<Scalar, Options>,
      pinocchio::JointModelEllipsoidTpl<Scalar, Options>,
      boost::recursive_wrapper<JointModelComposite>> JointModelVariant;
  typedef boost::variant<
      pinocchio::JointDataRevoluteUnalignedTpl<Scalar, Options>,
      pinocchio::JointDataRevoluteUnboundedUnalignedTpl<Scalar, Options>,
      pinocchio::JointDataPrismaticUnalignedTpl<Scalar, Options>,
      pinocchio::JointDataHelicalUnalignedTpl<Scalar, Options>,
      pinocchio::JointDataFreeFlyerTpl<Scalar, Options>,
      pinocchio::JointDataPlanarTpl<Scalar, Options>,
      pinocchio::JointDataSphericalTpl<Scalar, Options>,
      pinocchio::JointDataSphericalZYXTpl<Scalar, Options>,
      pinocchio::JointDataTranslationTpl<Scalar, Options>,
      pinocchio::JointDataUniversalTpl<Scalar, Options>,
      pinocchio::JointDataEllipsoidTpl<Scalar, Options>,
      boost::recursive_wrapper<JointDataComposite>> JointDataVariant;
};

using TheirModel = pinocchio::ModelTpl<double, 0, Joints>;
using TheirData = pinocchio::DataTpl<double, 0, Joints>;
using JointModel = TheirModel::JointModel;

SE3 placed(const Eigen::Matrix4d &pose) {
  return SE3(Matrix3d(pose.topLeftCorner<3, 3>()), Vector3d(pose.topRightCorner<3, 1>()));
}

JointModel made(const JointNumbers &joint) {
  const auto &n = joint.numbers;
  const auto axis = [&](size_t i) { return Vector3d(n.at(i), n.at(i + 1), n.at(i + 2)); };
  if (joint.kind == "revolute") return pinocchio::JointModelRevoluteUnalignedTpl<double, 0>(axis(0));
  if (joint.kind == "unbounded") return pinocchio::JointModelRevoluteUnboundedUnalignedTpl<double, 0>(axis(0));
  if (joint.kind == "prismatic") return pinocchio::JointModelPrismaticUnalignedTpl<double, 0>(axis(0));
  if (joint.kind == "helical") return pinocchio::JointModelHelicalUnalignedTpl<double, 0>(axis(0), n.at(3));
  if (joint.kind == "free flyer") return pinocchio::JointModelFreeFlyerTpl<double, 0>();
  if (joint.kind == "planar") return pinocchio::JointModelPlanarTpl<double, 0>();
  if (joint.kind == "spherical") return pinocchio::JointModelSphericalTpl<double, 0>();
  if (joint.kind == "spherical ZYX") return pinocchio::JointModelSphericalZYXTpl<double, 0>();
  if (joint.kind == "translation") return pinocchio::JointModelTranslationTpl<double, 0>();
  if (joint.kind == "universal") return pinocchio::JointModelUniversalTpl<double, 0>(axis(0), axis(3));
  if (joint.kind == "ellipsoid") return pinocchio::JointModelEllipsoidTpl<double, 0>(n.at(0), n.at(1), n.at(2));
  if (joint.kind != "composite") throw std::invalid_argument("a joint of kind " + joint.kind);
  pinocchio::JointModelCompositeTpl<double, 0, Joints> composite;
  for (const auto &[part, placement] : joint.parts) composite.addJoint(made(part), placed(placement));
  return composite;
}

// The members of Data that the algorithms below use; those of all algorithms take time and memory O(n³).
std::unique_ptr<TheirData> data_for(const TheirModel &model) {
  auto data = std::make_unique<TheirData>();
  const size_t n = model.njoints;
  const int nv = model.nv;
  for (const auto &joint : model.joints) data->joints.push_back(joint.createData());
  for (auto motions : {&TheirData::a, &TheirData::a_gf, &TheirData::oa, &TheirData::oa_gf, &TheirData::v, &TheirData::ov})
    ((*data).*motions).assign(n, pinocchio::Motion::Zero());
  for (auto forces : {&TheirData::f, &TheirData::of, &TheirData::h, &TheirData::oh})
    ((*data).*forces).assign(n, pinocchio::Force::Zero());
  for (auto poses : {&TheirData::oMi, &TheirData::liMi}) ((*data).*poses).assign(n, SE3::Identity());
  for (auto inertias : {&TheirData::oinertias, &TheirData::oYcrb}) ((*data).*inertias).assign(n, pinocchio::Inertia::Zero());
  data->doYcrb.assign(n, Eigen::Matrix<double, 6, 6>::Zero());
  for (auto matrix : {&TheirData::J, &TheirData::dJ, &TheirData::dVdq, &TheirData::dAdq, &TheirData::dAdv, &TheirData::dFdq,
                      &TheirData::dFdv, &TheirData::dFda})
    ((*data).*matrix).setZero(6, nv);
  for (auto matrix : {&TheirData::dtau_dq, &TheirData::dtau_dv}) ((*data).*matrix).setZero(nv, nv);
  data->Fcrb.assign(1, Matrix6x::Zero(6, nv));
  data->M.setZero(nv, nv);
  data->tau.setZero(nv);
  data->a_gf[0] = -model.gravity;
  data->nvSubtree.assign(n, 0);
  for (int i = model.njoints - 1; i > 0; --i) {
    data->nvSubtree[i] += model.nvs[i];
    data->nvSubtree[model.parents[i]] += data->nvSubtree[i];
  }
  data->parents_fromRow.assign(nv, -1);
  for (int i = 1; i < model.njoints; ++i) {
    const auto parent = model.parents[i];
    int before = parent ? model.idx_vs[parent] + model.nvs[parent] - 1 : -1;
    for (int row = model.idx_vs[i]; row < model.idx_vs[i] + model.nvs[i]; ++row) {
      data->parents_fromRow[row] = before;
      before = row;
    }
  }
  return data;
}

void list_simple(const JointNumbers &joint, const JointModel &theirs, std::vector<SimpleJoint> &list) {
  if (joint.kind != "composite") {
    list.push_back({joint.kind, theirs.idx_q(), theirs.idx_v()});
    return;
  }
  const auto &parts = boost::get<pinocchio::JointModelCompositeTpl<double, 0, Joints>>(theirs.toVariant()).joints;
  for (size_t i = 0; i < parts.size(); ++i) list_simple(joint.parts[i].first, parts[i], list);
}

} // namespace

struct Model::Inside {
  TheirModel model;
};

struct Data::Inside {
  std::unique_ptr<TheirData> data;
};

struct LoneJoint::Inside {
  const JointModel &model;
  TheirModel::JointData data;
};

Model::Model(const std::vector<Branch> &all, const Vec &armatures, const Vector3d &falling) : armature(armatures), branches(all) {
  auto built = std::make_shared<Inside>();
  TheirModel &theirs = built->model;
  for (const auto &each : branches) {
    const auto name = std::to_string(theirs.njoints);
    const auto joint = theirs.addJoint(each.parent, made(each.joint), placed(each.placement), name);
    theirs.appendBodyToJoint(joint, pinocchio::Inertia(each.mass, each.centre, each.inertia), SE3::Identity());
    list_simple(each.joint, theirs.joints[joint], simple_joints);
  }
  theirs.armature = armature;
  theirs.gravity = gravity = pinocchio::Motion(falling, Vector3d::Zero());
  inside = built;
  njoints = theirs.njoints;
  nq = theirs.nq;
  nv = theirs.nv;
  parents.assign(theirs.parents.begin(), theirs.parents.end());
  nqs = theirs.nqs;
  nvs = theirs.nvs;
  idx_qs = theirs.idx_qs;
  idx_vs = theirs.idx_vs;
  for (const auto &each : theirs.supports) supports.emplace_back(each.begin(), each.end());
  for (const auto &each : theirs.subtrees) subtrees.emplace_back(each.begin(), each.end());
  inertias = theirs.inertias;
}

void Model::set_body(int joint, double mass, const Vector3d &centre, const Matrix3d &inertia) {
  Branch &branch = branches.at(joint - 1);
  branch.mass = mass;
  branch.centre = centre;
  branch.inertia = inertia;
  auto body = pinocchio::Inertia::Zero(); // the same numbers as by `appendBodyToJoint`
  body += pinocchio::Inertia(mass, centre, inertia);
  inertias[joint] = inside->model.inertias[joint] = body;
}

Data::Data(std::shared_ptr<const Model> its_model)
    : model(std::move(its_model)), inside(new Inside{data_for(model->inside->model)}),
      oMi(inside->data->oMi), liMi(inside->data->liMi), v(inside->data->v), a(inside->data->a),
      a_gf(inside->data->a_gf), ov(inside->data->ov), oa(inside->data->oa), of(inside->data->of),
      oYcrb(inside->data->oYcrb), doYcrb(inside->data->doYcrb), J(inside->data->J), M(inside->data->M),
      dtau_dq(inside->data->dtau_dq), dtau_dv(inside->data->dtau_dv), tau(inside->data->tau),
      parents_fromRow(inside->data->parents_fromRow) {}

LoneJoint::LoneJoint(const Model &model, int joint)
    : inside_(new Inside{model.inside->model.joints[joint], model.inside->model.joints[joint].createData()}) {}

void LoneJoint::move(const Vec &q, const Vec &v) {
  inside_->model.calc(inside_->data, q, v);
  S = inside_->data.S().matrix();
  c = inside_->data.c().toVector();
}

namespace library {

const Vec &rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a) {
  return pinocchio::rnea(model.inside->model, *data.inside->data, q, v, a);
}

void differentiate_rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a) {
  pinocchio::computeRNEADerivatives(model.inside->model, *data.inside->data, q, v, a);
}

void joint_jacobians(const Model &model, Data &data, const Vec &q) {
  pinocchio::computeJointJacobians(model.inside->model, *data.inside->data, q);
}

void joint_jacobians(const Model &model, Data &data) {
  pinocchio::computeJointJacobians(model.inside->model, *data.inside->data);
}

void integrate(const Model &model, const Vec &q, const Vec &v, Vec &out) {
  pinocchio::integrate(model.inside->model, q, v, out);
}

void difference(const Model &model, const Vec &q0, const Vec &q1, Vec &out) {
  pinocchio::difference(model.inside->model, q0, q1, out);
}

void differentiate_integration(const Model &model, const Vec &q, const Vec &v, Mat &out) {
  pinocchio::dIntegrate(model.inside->model, q, v, out, pinocchio::ARG0);
}

Vec neutral(const Model &model) {
  return pinocchio::neutral(model.inside->model);
}

} // namespace library

} // namespace pinconsist
