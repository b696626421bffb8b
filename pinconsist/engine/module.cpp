// Python bindings: a system to which rows and forces are added, and the classes that use it.
#include "callback_system.hpp"
#include "closure.hpp"
#include "collocation.hpp"
#include "index1.hpp"
#include "kept_rows.hpp"
#include "measured.hpp"
#include "numbers.hpp"
#include "rates.hpp"

#include <Eigen/QR>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <optional>

namespace pinconsist {

void bind_steppers(nb::module_ &m);  // steppers.cpp, compiled in parallel
void bind_gradients(nb::module_ &m); // gradients.cpp
void bind_complementarity(nb::module_ &m);

// Here, since the decomposition takes a tenth of the time in which a file is compiled.
Table MechanismSystem::complete(double t, const Table &configurations, Table multipliers, const std::vector<int> &steady) {
  constexpr double DEPENDENT = 1e-10; // relative to the largest pivot
  Eigen::CompleteOrthogonalDecomposition<Mat> factors;
  factors.setThreshold(DEPENDENT);
  for (Eigen::Index i = 0; i < multipliers.rows(); ++i) {
    evaluate_rows(t, configurations.row(i).transpose());
    const Mat G = W(steady, Eigen::all).transpose();
    const Vec lam = multipliers.row(i)(steady).transpose();
    factors.compute(G);
    multipliers.row(i)(steady) = factors.solve(G * lam).transpose();
  }
  return multipliers;
}

bool KeptRows::poor(const Vec &p) {
  if (kept_.empty()) return false;
  std::optional<nb::gil_scoped_acquire> holds; // rows that were left out may call Python although those that were kept do not
  if (all_.calls_python()) holds.emplace();
  all_.constraint(t_, p, Vec::Zero(all_.nv));
  const Mat J = scales_.cwiseInverse().asDiagonal() * all_.W;
  const double strongest = J.bdcSvd().singularValues()[kept_.size() - 1];
  return !(J(kept_, Eigen::all).bdcSvd().singularValues().tail(1)[0] > WEAK * strongest);
}

namespace {

using namespace nb::literals;
using Pose = Eigen::Matrix4d;
using Place = std::array<int, 3>;     // of a joint: Coordinate
using MotionNumbers = std::array<double, 5>;
using Range = std::pair<double, double>;
using Shares = std::vector<std::pair<Place, double>>; // of joints in a sum

// Independent rows first, and how far each is from a combination of those before it. Of rows that are equally far the
// first one is taken, whatever rounding says.
nb::tuple pivoted(const Mat &rows) {
  constexpr double EQUAL = 1e-10;
  Mat A = rows.transpose();
  const Eigen::Index n = A.cols(), most = std::min(A.rows(), n);
  Eigen::VectorX<std::int64_t> order = Eigen::VectorX<std::int64_t>::LinSpaced(n, 0, n - 1);
  Vec sizes(most), reflector;
  for (Eigen::Index k = 0; k < most; ++k) {
    const Vec left = A.bottomRightCorner(A.rows() - k, n - k).colwise().norm().transpose();
    Eigen::Index chosen = 0;
    while (left[chosen] < (1.0 - EQUAL) * left.maxCoeff()) ++chosen;
    sizes[k] = left[chosen];
    A.col(k).swap(A.col(k + chosen));
    std::swap(order[k], order[k + chosen]);
    if (sizes[k] == 0.0) continue;
    reflector = A.col(k).tail(A.rows() - k);
    reflector[0] += std::copysign(sizes[k], reflector[0]);
    auto rest = A.bottomRightCorner(A.rows() - k, n - k - 1);
    const Vec parts = rest.transpose() * reflector * (2.0 / reflector.squaredNorm());
    rest -= reflector * parts.transpose();
  }
  return nb::make_tuple(order, sizes);
}

nb::handle lapack_loader; // let go at the end of the process

// Arguments from Python as the types that rows and forces take.
SE3 taken(const Pose &pose) { return SE3(Matrix3d(pose.topLeftCorner<3, 3>()), Vector3d(pose.topRightCorner<3, 1>())); }
Motion taken(const MotionNumbers &n) { return {n[0], n[1], n[2], n[3], n[4]}; }
Coordinate taken(const Place &n) { return {n[0], n[1], n[2] != 0}; }
Sum taken(const Shares &shares) {
  Sum sum;
  for (const auto &[joint, share] : shares) {
    sum.joints.push_back(taken(joint));
    sum.shares.push_back(share);
  }
  return sum;
}
template <class Other> const Other &taken(const Other &x) { return x; }

// The numbers of a motion, or a function.
Curve curve(const nb::object &given) {
  if (nb::isinstance<nb::tuple>(given)) return taken(nb::cast<MotionNumbers>(given));
  return Curve(given);
}
// Three numbers, or a function.
VectorCurve vector_curve(const nb::object &given) {
  if (PyCallable_Check(given.ptr())) return VectorCurve(given);
  return nb::cast<Vector3d>(given);
}

template <class Part, class... Given> auto made(const MechanismSystem &s, const Given &...given) {
  if constexpr (std::is_constructible_v<Part, const Model &, const TurningAxes &, decltype(taken(given))...>)
    return std::make_unique<Part>(s.model(), s.axes(), taken(given)...);
  else if constexpr (std::is_constructible_v<Part, const Model &, decltype(taken(given))...>)
    return std::make_unique<Part>(s.model(), taken(given)...);
  else return std::make_unique<Part>(taken(given)...);
}
// Functions that add rows, or a force, constructed from these arguments.
template <class Part, class... Given> auto adds() {
  return [](MechanismSystem &s, const Given &...given) {
    if constexpr (std::is_base_of_v<Rows, Part>) s.add_rows(made<Part>(s, given...));
    else s.add_force(made<Part>(s, given...));
  };
}

} // namespace
} // namespace pinconsist

NB_MODULE(_engine, m) {
  using namespace pinconsist;
  nb::set_leak_warnings(false); // functions of users may refer to what holds them
  m.def("constant", [](const std::string &name) { return *constants().at(name); });
  m.def("constants", [] {
    nb::dict all;
    for (const auto &[name, value] : constants()) all[name.c_str()] = *value;
    return all;
  });
  m.def("set_constant", [](const std::string &name, double value) { *constants().at(name) = value; }); // for benchmarks
  m.def("instruction_sets", [] { // for which the evaluation of several states was compiled, and that this processor has
    const char *names[lanes::MOST_KERNELS];
    const int number = lanes::names(names);
    return std::vector<std::string>(names, names + number);
  });
  m.def("use_instruction_set", &lanes::use); // for tests; "" is the best; runs that exist keep theirs
  m.def("load_lapack_by", [](nb::object function) { // which calls use_lapack
    lapack_loader.dec_ref();
    lapack_loader = function.release();
    Lapack::load = [] {
      nb::gil_scoped_acquire holds;
      lapack_loader();
    };
  }, "function"_a.none());
  m.def("use_lapack", [](nb::capsule factorise, nb::capsule solve) {
    Lapack::factorise = reinterpret_cast<Lapack::Factorise>(factorise.data());
    Lapack::solve = reinterpret_cast<Lapack::Solve>(solve.data());
  });

  m.def("use_radau", [](const Vec &c, const Mat &A, const Mat &inverse, const Mat &inverse2, const Mat &modes,
                        const Mat &raised, const Mat &eigenvalues, const Mat &eigenvectors, const Mat &to_eigenvectors, const Vec &between,
                        const Vec &weights, const Mat &reach) {
    const int s = static_cast<int>(c.size());
    const Vec signs = Vec::NullaryExpr(s, [](Eigen::Index k) { return k % 2 ? -1.0 : 1.0; });
    const Mat at_start = signs.transpose() * modes;
    RadauTable::of[s] = {s, c, A, inverse, inverse2, modes, raised, between, weights, reach, eigenvalues, eigenvectors, to_eigenvectors, at_start.transpose(),
                         (modes.row(s - 1) * inverse2).norm(), (at_start * inverse2).norm()};
  });
  m.def("pivoted", &pivoted);
  nb::class_<JointNumbers>(m, "JointNumbers")
      .def("__init__",
           [](JointNumbers *at, std::string kind, std::vector<double> numbers,
              const std::vector<std::pair<JointNumbers *, Pose>> &parts) {
             new (at) JointNumbers{std::move(kind), std::move(numbers), {}};
             for (const auto &[part, placement] : parts) at->parts.push_back({*part, placement});
           }, "kind"_a, "numbers"_a, "parts"_a);
  nb::class_<Branch>(m, "Branch")
      .def("__init__",
           [](Branch *at, const JointNumbers &joint, int parent, const Pose &placement, double mass, const Vector3d &centre,
              const Matrix3d &inertia) { new (at) Branch{joint, parent, placement, mass, centre, inertia}; },
           "joint"_a, "parent"_a, "placement"_a, "mass"_a, "centre"_a, "inertia"_a);
  nb::class_<Model>(m, "Tree")
      .def("__init__",
           [](Model *at, const std::vector<Branch *> &branches, const Vec &armature, const Vector3d &gravity) {
             std::vector<Branch> all;
             for (const auto *each : branches) all.push_back(*each);
             new (at) Model(all, armature, gravity);
           },
           "branches"_a, "armature"_a, "gravity"_a);
  nb::class_<Data>(m, "Workspace").def(nb::init<std::shared_ptr<const Model>>(), "tree"_a);

  nb::class_<System>(m, "System").def_ro("nc", &System::nc).def_prop_ro("calls_python", &System::calls_python);
  nb::class_<CallbackSystem, System>(m, "CallbackSystem").def(nb::init<nb::object>(), "system"_a);
  nb::class_<MechanismSystem, System>(m, "MechanismSystem")
      .def(nb::init<std::shared_ptr<Data>>(), "workspace"_a)
      .def("add_anchored",
           [](MechanismSystem &s, int joint1, const Pose &place1, int joint2, const Pose &place2, const Mat &matrix, bool fresh) {
             s.add_rows(made<AnchoredRows>(s, joint1, place1, joint2, place2, matrix), fresh);
           })
      .def("add_limit", adds<LimitRow, Place, double, double, double>())
      .def("add_rope", adds<RopeRow, int, Pose, int, Pose, double>())
      .def("add_sliding", adds<SlidingRow, int, Pose, int, Pose, Mat, double, Vec, double>())
      .def("add_pin", adds<PinRow, int, Pose, int, Pose, double>())
      .def("add_turning_pin", adds<TurningPin, int, Pose, int, Pose, std::vector<int>, Mat, double>())
      .def("combine", &MechanismSystem::combine, "combination"_a)
      .def("aim", &MechanismSystem::aim, "t"_a, "p"_a, "v"_a)
      .def("add_distance", adds<DistanceRow, int, Pose, int, Pose, double>())
      .def("add_turn", adds<TurnRows, int, Pose, int, Pose>())
      .def("add_tilt", adds<TiltRows, int, Pose, int, Pose, Vector3d, Mat>())
      .def("add_drive", // here and below, a curve is the numbers of a motion or a function
           [](MechanismSystem &s, const Place &joint, double period, const nb::object &along) {
             s.add_rows(std::make_unique<DriveRow>(taken(joint), period, curve(along)));
           })
      .def("add_coupling", adds<CouplingRow, Shares, Shares, double, Vec>())
      .def("add_python_rows",
           [](MechanismSystem &s, nb::object closure, std::vector<int> local, bool moving, double step) {
             s.add_rows(std::make_unique<PythonRows>(closure, std::move(local), moving, step));
           })
      .def("torque", &MechanismSystem::torque)
      .def("torque_derivatives", &MechanismSystem::torque_derivatives)
      .def("loads", // joint, point, force, moment
           [](MechanismSystem &s, double t, const Vec &p, const Vec &v) {
             nb::list loads;
             for (const auto &load : s.loads(t, p, v)) loads.append(nb::make_tuple(load.joint, load.x, load.f, load.m));
             return loads;
           })
      .def("along", &MechanismSystem::along)
      .def("stored", &MechanismSystem::stored)
      .def("limited", &MechanismSystem::limited)
      .def_prop_ro("G_transposed", [](const MechanismSystem &s) { return s.G_transposed(); }) // of the last evaluation
      .def_prop_ro("in_lanes", [](MechanismSystem &s) { return s.in_lanes() != nullptr; })
      .def_prop_ro("number_of_rows", &MechanismSystem::number_of_rows)
      .def_prop_ro("number_of_forces", &MechanismSystem::number_of_forces)
      .def("add_constant", &MechanismSystem::add_constant)
      .def("add_damping", &MechanismSystem::add_damping)
      .def("add_friction", adds<SmoothFriction, Vec, double>())
      .def("add_servo",
           [](MechanismSystem &s, const Place &joint, double period, const nb::object &target, double stiffness, double damping) {
             s.add_force(std::make_unique<Servo>(taken(joint), period, curve(target), stiffness, damping));
           })
      .def("add_joint_spring", adds<JointSpring, Place, double, double, double, double>())
      .def("add_torque_curve",
           [](MechanismSystem &s, int column, const nb::object &torque) {
             s.add_force(std::make_unique<TorqueCurve>(column, curve(torque)));
           })
      .def("add_time_torque", adds<TimeTorque, int, int, nb::object>())
      .def("add_spring", adds<SpringDamper, int, Vector3d, int, Vector3d, double, double, double, double>())
      .def("add_wrench",
           [](MechanismSystem &s, int joint, const Pose &frame, const nb::object &force, const nb::object &moment, bool local) {
             s.add_force(std::make_unique<Wrench>(s.model(), s.axes(), joint, taken(frame), vector_curve(force), vector_curve(moment), local));
           })
      .def("add_held", adds<HeldTorque, std::shared_ptr<HeldTable>>())
      .def("add_actuator",
           [](MechanismSystem &s, const std::vector<Place> &joints, const Vec &arms, const Vector3d &gain, const Vector3d &bias,
              const Range &control, const Range &force, const nb::object &command, const std::vector<double> &times,
              const std::vector<double> &values, std::shared_ptr<HeldTable> held) {
             std::vector<Coordinate> places;
             for (const auto &joint : joints) places.push_back(taken(joint));
             s.add_force(std::make_unique<Actuator>(places, arms, Actuator::Law{gain, bias, control, force},
                                                    Actuator::Command{curve(command), times, values, std::move(held)}));
           }, "joints"_a, "arms"_a, "gain"_a, "bias"_a, "control"_a, "force"_a, "command"_a, "times"_a, "values"_a, "held"_a.none())
      .def("add_python_force", adds<PythonForce, nb::object>())
      .def("evaluate",
           [](MechanismSystem &s, double t, const Vec &p, const Vec &v, const Vec &a) {
             s.evaluate(t, p, v, a);
             return nb::make_tuple(s.f, s.phi, s.W, s.rho);
           })
      .def("rows", // Φ and J
           [](MechanismSystem &s, const Vec &p, double t) {
             s.constraint(t, p, Vec::Zero(s.nv));
             return nb::make_tuple(s.phi, s.W);
           }, "p"_a, "t"_a = 0.0)
      .def("constraint", // Φ and J v + Φ_t
           [](MechanismSystem &s, double t, const Vec &p, const Vec &v) {
             s.constraint(t, p, v);
             return nb::make_tuple(s.phi, s.rho);
           })
      .def("dynamics", // M, inertial forces less τ, J and its rate times v
           [](MechanismSystem &s, double t, const Vec &p, const Vec &v) {
             Vec bias;
             Mat M(s.nv, s.nv);
             s.evaluate_bias(t, p, v, false, bias);
             s.mass_matrix(t, p, v, M);
             return nb::make_tuple(M, s.f, s.W, bias);
           })
      .def("row_gradients", // None where they are not known
           [](MechanismSystem &s, double t, const Vec &p, const Vec &v, const Vec &lam) -> nb::object {
             Mat F = Mat::Zero(s.nv, s.nx), H = Mat::Zero(s.nc, s.nx);
             s.constraint(t, p, v);
             return s.row_gradients(t, p, v, lam, F, H) ? nb::object(nb::make_tuple(F, H)) : nb::none();
           })
      .def("chart_points", &MechanismSystem::chart_points)
      .def("residuals",
           [](MechanismSystem &s, const Vec &t, const Table &p, const Table &v, const Table &lam) {
             auto all = residuals(s, t, p, v, lam);
             return nb::make_tuple(std::move(all[0]), std::move(all[1]), std::move(all[2]));
           })
      .def("energies", &energies)
      .def("torques", &torques)
      .def("wrenches",
           [](MechanismSystem &s, const Vec &t, const Table &p, const Table &lam, int joint1, const Pose &place1, int joint2,
              const Pose &place2, bool in_world) {
             return wrenches(s, t, p, lam, joint1, taken(place1), joint2, taken(place2), in_world);
           })
      .def("gaps", &MechanismSystem::gaps)
      .def("complete", &MechanismSystem::complete)
      .def("evaluate_at_once", // f, Φ, J, M, D, K of states, one a row or matrix; None if they are not evaluated in lanes
           [](MechanismSystem &s, const Vec &t, const Table &p, const Table &v, const Table &a) -> nb::object {
             const lanes::Tree *tree = s.in_lanes();
             if (!tree) return nb::none();
             const int n = static_cast<int>(t.size());
             StateLanes states;
             states.use(*tree, n);
             for (int i = 0; i < n; ++i) states.set(i, &p(i, 0), &v(i, 0), &a(i, 0));
             s.evaluate_lanes(t, states, true);
             const auto all = [&](const double *numbers, long items) {
               Table table(n, items);
               for (int i = 0; i < n; ++i) states.get(numbers, items, i, &table(i, 0));
               return table;
             };
             const lanes::Fields &of = states.fields;
             const long square = static_cast<long>(s.nv) * s.nv;
             return nb::make_tuple(all(of.f, s.nv), all(of.phi, s.nc), all(of.J, static_cast<long>(s.nc) * s.nv),
                                   all(of.M, square), all(of.D, square), all(of.K, square));
           })
      .def("linearize", [](MechanismSystem &s, double t, const Vec &p, const Vec &v, const Vec &a, double c) {
        s.evaluate(t, p, v, a);
        Mat A(s.nv, s.nv);
        s.linearize(t, p, v, a, Vec(), c, A, true);
        return A;
      });

  nb::class_<Numbers>(m, "Numbers")
      .def(nb::init<Model &, MechanismSystem &>(), "tree"_a, "system"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>())
      .def("add_body", &Numbers::add_body, "joint"_a)
      .def("add_place", &Numbers::add_place, "part"_a, "end"_a, "now"_a)
      .def("add_note", &Numbers::add_note, "now"_a)
      .def("add_number", &Numbers::add_number, "force"_a, "name"_a)
      .def("add_damping", &Numbers::add_damping)
      .def_prop_ro("values", [](const Numbers &numbers) { return array(numbers.values()); })
      .def("set", &Numbers::set, "values"_a);

  nb::class_<Rates, MechanismSystem>(m, "Rates")
      .def(nb::init<std::shared_ptr<Data>>(), "workspace"_a)
      .def("add_inertia", &Rates::add_inertia)
      .def("add_gravity", &Rates::add_gravity)
      .def("close", &Rates::close)
      .def("set_times", &Rates::set_times)
      .def("set_held", &Rates::set_held)
      .def("act", &Rates::act)
      .def("columns", [](Rates &rates, double t, const Vec &p, const Vec &v, const Vec &a, int parameters) {
        Mat r = Mat::Zero(rates.nv, parameters);
        rates.add_columns(t, p, v, a, r);
        return r;
      });

  nb::class_<HeldTable>(m, "HeldTable")
      .def(nb::init<>())
      .def("clear", &HeldTable::clear)
      .def("hold", &HeldTable::hold)
      .def("reached", &HeldTable::reached)
      .def("at", // None before the first entry
           [](const HeldTable &table, double t) -> nb::object {
             if (table.torques.empty()) return nb::none();
             Vec torque = Vec::Zero(table.torques.front().size());
             return table.add(t, torque) ? array(torque) : nb::none();
           })
      .def_rw("entered", &HeldTable::entered)
      .def_rw("linear", &HeldTable::linear)
      .def_rw("on_steps", &HeldTable::on_steps)
      .def_rw("begun", &HeldTable::begun);

  nb::class_<ClosureFollower>(m, "ClosureFollower")
      .def(nb::init<MechanismSystem &, std::vector<int>, const Vec &, const std::array<double, 9> &>(), "system"_a,
           "coordinates"_a, "sizes"_a, "numbers"_a, nb::keep_alive<1, 2>())
      .def("follow", &ClosureFollower::follow);

  nb::class_<Projection>(m, "Projection")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("acceleration", // with whether it is finite; None where the equations are singular
           [](Projection &projection, double t, const Vec &p, const Vec &v) -> nb::object {
             Vec a, lam;
             if (!projection.acceleration(t, p, v, a, lam)) return nb::none();
             const bool finite = a.allFinite() && lam.allFinite();
             return nb::make_tuple(array(a), array(lam), finite);
           })
      .def("velocity_shift", // None where the equations are singular
           [](Projection &projection, double t, const Vec &p, const Vec &v, const Vec &rho) -> nb::object {
             Vec found;
             return projection.velocity_shift(t, p, v, rho, found) ? nb::object(array(found)) : nb::object(nb::none());
           })
      .def("project", [](Projection &projection, double t, const Vec &p, const Vec &v) {
        const State state = projection.project(t, p, v);
        return nb::make_tuple(array(state.p), array(state.v), state.failure, state.gap);
      });

  m.def("certified", // None if the equations are singular or not finite at some row
        [](const std::vector<std::pair<MechanismSystem *, Forces>> &systems, const std::vector<int> &kept, const Vec &t,
           const Table &p, const Table &v, const Table &lam) -> nb::object {
          Certified found;
          {
            std::optional<nb::gil_scoped_release> release;
            if (!systems.front().first->calls_python()) release.emplace();
            found = certified(systems, kept, t, p, v, lam);
          }
          if (!found.complete) return nb::none();
          return nb::make_tuple(std::move(found.phi), std::move(found.rho), std::move(found.forces), std::move(found.exact),
                                std::move(found.energies), found.acting);
        });

  bind_steppers(m);
  bind_gradients(m);
  bind_complementarity(m);
}
