// Trees of bodies, built from numbers, and Pinocchio's algorithms on them, which tree.cpp compiles, with a collection of
// joints of our own. Nothing is shared with the Pinocchio of Python, so any version of that will do.
#pragma once

#include <pinocchio/spatial.hpp>

#include <memory>
#include <string>
#include <vector>

namespace pinconsist {

using SE3 = pinocchio::SE3;
using Vec = Eigen::VectorXd;
using Mat = Eigen::MatrixXd;
using Matrix6x = Eigen::Matrix<double, 6, Eigen::Dynamic>;

// A joint in numbers: axes, pitches or radii, as its kind needs them; the parts of a composite one.
struct JointNumbers {
  std::string kind;
  std::vector<double> numbers;
  std::vector<std::pair<JointNumbers, Eigen::Matrix4d>> parts;
};

// A joint in the tree, with the body that it carries: mass, centre of mass, and inertia about it.
struct Branch {
  JointNumbers joint;
  int parent;
  Eigen::Matrix4d placement;
  double mass;
  Eigen::Vector3d centre;
  Eigen::Matrix3d inertia;
};

// A joint that is not composite, or a part of a composite one, with its first coordinates.
struct SimpleJoint {
  std::string kind;
  int idx_q, idx_v;
};

// A tree of bodies, the ground first; branches follow their parents. Names are those of Pinocchio's Model.
struct Model {
  Model(const std::vector<Branch> &branches, const Vec &armature, const Eigen::Vector3d &gravity);
  // Gives the body at a joint other inertial parameters, those of a branch.
  void set_body(int joint, double mass, const Eigen::Vector3d &centre, const Eigen::Matrix3d &inertia);

  int njoints, nq, nv;
  std::vector<int> parents, nqs, nvs, idx_qs, idx_vs;
  std::vector<std::vector<int>> supports, subtrees;
  std::vector<pinocchio::Inertia> inertias;
  pinocchio::Motion gravity;
  Vec armature;
  std::vector<SimpleJoint> simple_joints;
  std::vector<Branch> branches;

  struct Inside;
  std::shared_ptr<Inside> inside;
};

// The workspace of Pinocchio's algorithms on a tree, for one thread at a time. Names are those of Pinocchio's Data.
struct Data {
  explicit Data(std::shared_ptr<const Model> model);

  const std::shared_ptr<const Model> model;

  struct Inside;
  const std::shared_ptr<Inside> inside;
  std::vector<SE3> &oMi, &liMi;
  std::vector<pinocchio::Motion> &v, &a, &a_gf, &ov, &oa;
  std::vector<pinocchio::Force> &of;
  std::vector<pinocchio::Inertia> &oYcrb;
  std::vector<Eigen::Matrix<double, 6, 6>> &doYcrb;
  Matrix6x &J;
  Mat &M;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> &dtau_dq, &dtau_dv;
  Vec &tau;
  std::vector<int> &parents_fromRow;
};

// Pinocchio's algorithms.
namespace library {
const Vec &rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a);
void differentiate_rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a);
void joint_jacobians(const Model &model, Data &data, const Vec &q);
void joint_jacobians(const Model &model, Data &data); // of poses that are known
void integrate(const Model &model, const Vec &q, const Vec &v, Vec &out);
void difference(const Model &model, const Vec &q0, const Vec &q1, Vec &out);
void differentiate_integration(const Model &model, const Vec &q, const Vec &v, Mat &out); // with respect to q
Vec neutral(const Model &model);
} // namespace library

// A joint of a tree by itself, at positions and velocities of its own.
class LoneJoint {
public:
  LoneJoint(const Model &model, int joint);
  void move(const Vec &q, const Vec &v); // of the whole tree

  Matrix6x S;                    // motion subspace
  Eigen::Matrix<double, 6, 1> c; // bias of the acceleration

private:
  struct Inside;
  std::shared_ptr<Inside> inside_;
};

} // namespace pinconsist
