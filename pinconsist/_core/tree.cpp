// Trees of bodies built from numbers, and Pinocchio's algorithms on them.
#include "tree.hpp"

#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <stdexcept>

namespace pinconsist {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using JointModel = Model::JointModel;

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
std::shared_ptr<Data> data_for(const Model &model) {
  auto data = std::make_shared<Data>();
  const size_t n = model.njoints;
  const int nv = model.nv;
  for (const auto &joint : model.joints) data->joints.push_back(joint.createData());
  for (auto motions : {&Data::a, &Data::a_gf, &Data::oa, &Data::oa_gf, &Data::v, &Data::ov})
    ((*data).*motions).assign(n, Data::Motion::Zero());
  for (auto forces : {&Data::f, &Data::of, &Data::h, &Data::oh}) ((*data).*forces).assign(n, Data::Force::Zero());
  for (auto poses : {&Data::oMi, &Data::liMi}) ((*data).*poses).assign(n, SE3::Identity());
  for (auto inertias : {&Data::oinertias, &Data::oYcrb}) ((*data).*inertias).assign(n, Data::Inertia::Zero());
  data->doYcrb.assign(n, Data::Inertia::Matrix6::Zero());
  for (auto matrix : {&Data::J, &Data::dJ, &Data::dVdq, &Data::dAdq, &Data::dAdv, &Data::dFdq, &Data::dFdv, &Data::dFda})
    ((*data).*matrix).setZero(6, nv);
  for (auto matrix : {&Data::dtau_dq, &Data::dtau_dv}) ((*data).*matrix).setZero(nv, nv);
  data->Fcrb.assign(1, Data::Matrix6x::Zero(6, nv));
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

} // namespace

Tree::Tree(const std::vector<Branch> &branches, const Vec &armature, const Vector3d &gravity) : kinds{""} {
  auto built = std::make_shared<Model>();
  for (const auto &each : branches) {
    const auto name = std::to_string(kinds.size());
    const auto joint = built->addJoint(each.parent, made(each.joint), placed(each.placement), name);
    built->appendBodyToJoint(joint, pinocchio::Inertia(each.mass, each.centre, each.inertia), SE3::Identity());
    kinds.push_back(each.joint.kind);
  }
  built->armature = armature;
  built->gravity.linear() = gravity;
  built->gravity.angular().setZero();
  model = built;
}

Workspace::Workspace(std::shared_ptr<const Tree> its_tree)
    : tree(std::move(its_tree)), data(data_for(*tree->model)) {}

namespace library {

const Vec &rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a) {
  return pinocchio::rnea(model, data, q, v, a);
}

void differentiate_rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a) {
  pinocchio::computeRNEADerivatives(model, data, q, v, a);
}

void joint_jacobians(const Model &model, Data &data, const Vec &q) { pinocchio::computeJointJacobians(model, data, q); }

void joint_jacobians(const Model &model, Data &data) { pinocchio::computeJointJacobians(model, data); }

void integrate(const Model &model, const Vec &q, const Vec &v, Vec &out) { pinocchio::integrate(model, q, v, out); }

void difference(const Model &model, const Vec &q0, const Vec &q1, Vec &out) { pinocchio::difference(model, q0, q1, out); }

void differentiate_integration(const Model &model, const Vec &q, const Vec &v, Mat &out) {
  pinocchio::dIntegrate(model, q, v, out, pinocchio::ARG0);
}

Vec neutral(const Model &model) { return pinocchio::neutral(model); }

Mat motion_subspace(const Model &model, int joint, Model::JointData &work, const Vec &q, const Vec &v) {
  model.joints[joint].calc(work, q, v);
  return work.S().matrix();
}

} // namespace library

} // namespace pinconsist
