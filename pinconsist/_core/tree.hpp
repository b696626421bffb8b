// Pinocchio's algorithms for a collection of joints of our own, and models that are built from numbers: nothing is shared
// with the Pinocchio of Python, so any version of that will do.
#pragma once

#include <pinocchio/multibody.hpp>
#include <pinocchio/spatial.hpp>

#include <memory>
#include <string>
#include <vector>

namespace pinconsist {

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

using Model = pinocchio::ModelTpl<double, 0, Joints>;
using Data = pinocchio::DataTpl<double, 0, Joints>;
using SE3 = pinocchio::SE3Tpl<double, 0>;
using Vec = Eigen::VectorXd;
using Mat = Eigen::MatrixXd;

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

// A tree of bodies; branches follow their parents. `kinds` are those of the joints, of the ground first.
struct Tree {
  Tree(const std::vector<Branch> &branches, const Vec &armature, const Eigen::Vector3d &gravity);

  std::shared_ptr<const Model> model;
  std::vector<std::string> kinds;
};

// A tree with the data of Pinocchio's algorithms, for one thread at a time.
struct Workspace {
  explicit Workspace(std::shared_ptr<const Tree> tree);

  std::shared_ptr<const Tree> tree;
  std::shared_ptr<Data> data;
};

// Pinocchio's algorithms, compiled once, in tree.cpp.
namespace library {
const Vec &rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a);
void differentiate_rnea(const Model &model, Data &data, const Vec &q, const Vec &v, const Vec &a);
void joint_jacobians(const Model &model, Data &data, const Vec &q);
void joint_jacobians(const Model &model, Data &data); // of poses that are known
void integrate(const Model &model, const Vec &q, const Vec &v, Vec &out);
void difference(const Model &model, const Vec &q0, const Vec &q1, Vec &out);
void differentiate_integration(const Model &model, const Vec &q, const Vec &v, Mat &out); // with respect to q
Vec neutral(const Model &model);
// The motion subspace of a joint; `work` holds it, and the bias of the acceleration, too.
Mat motion_subspace(const Model &model, int joint, Model::JointData &work, const Vec &q, const Vec &v);
} // namespace library

} // namespace pinconsist
