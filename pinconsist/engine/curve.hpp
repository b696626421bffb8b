// Functions of time: by numbers, or in Python.
#pragma once

#include "system.hpp"

#include <cmath>

namespace pinconsist {

// mechanism/motion.py
struct Motion {
  double start = 0.0, speed = 0.0, amplitude = 0.0, frequency = 0.0, phase = 0.0;

  double omega() const { return 2.0 * M_PI * frequency; }
  double operator()(double t) const {
    return start + speed * t + amplitude * std::sin(omega() * t + phase);
  }
  double rate(double t) const { return speed + amplitude * omega() * std::cos(omega() * t + phase); }
  double acceleration(double t) const { return -amplitude * omega() * omega() * std::sin(omega() * t + phase); }
};

// A motion, or an object in Python with the methods `rate` and `acceleration`, if these are needed.
class Curve {
public:
  Curve(Motion motion) : motion_(motion) {}
  explicit Curve(nb::object function) : function_(std::move(function)) {}

  double operator()(double t) const { return calls_python() ? nb::cast<double>(function_(t)) : motion_(t); }
  double rate(double t) const { return calls_python() ? nb::cast<double>(ask(function_, "rate", t)) : motion_.rate(t); }
  double acceleration(double t) const {
    return calls_python() ? nb::cast<double>(ask(function_, "acceleration", t)) : motion_.acceleration(t);
  }
  bool calls_python() const { return function_.is_valid(); }

private:
  Motion motion_;
  nb::object function_;
};

// A vector: constant, or a function of time in Python.
class VectorCurve {
public:
  VectorCurve(const Eigen::Vector3d &constant) : constant_(constant) {}
  explicit VectorCurve(nb::object function) : function_(std::move(function)) {}

  Eigen::Vector3d operator()(double t) const { return calls_python() ? nb::cast<Eigen::Vector3d>(function_(t)) : constant_; }
  bool calls_python() const { return function_.is_valid(); }

private:
  Eigen::Vector3d constant_ = Eigen::Vector3d::Zero();
  nb::object function_;
};

} // namespace pinconsist
